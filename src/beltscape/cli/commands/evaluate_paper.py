"""``beltscape evaluate paper [--size quarter|half|full] [--seed N]``: repeats the paper's experiments."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import add_output_folder, add_workers
from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_output_folder(parser, "folder (default: beltscape-paper)", default=Path("beltscape-paper"))
    parser.add_argument(
        "--size", choices=("full", "half", "quarter"), default="quarter",
        help="of the rendered images: half is 1224 × 1024 (default: quarter)",
    )  # fmt: skip
    parser.add_argument(
        "--captures", type=Path, metavar="DIR",
        help="captures with their truth instead of rendering: calibration, module, belt_empty, belt_loaded, "
        "each also with _nospeckle",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=1, help="of heap, board poses and noise (1)")
    add_workers(parser)


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Run the paper's experiments and write report.html and paper.json."""
    from beltscape.evaluate.paper.experiments import evaluate_paper, make_paper_document
    from beltscape.evaluate.paper.laboratory import read_laboratory, render_laboratory
    from beltscape.evaluate.paper.page import render_paper_page
    from beltscape.files.atomic import ensure_output_folder, write_text
    from beltscape.files.json_text import write_json
    from beltscape.workers.options import WorkerOptions

    workers = WorkerOptions(arguments.workers, arguments.address)
    if arguments.address is not None:  # workers elsewhere have another working folder
        arguments.captures = arguments.captures and arguments.captures.absolute()
        arguments.out = arguments.out.absolute()
    given = arguments.captures and read_laboratory(arguments.captures)
    out = ensure_output_folder(arguments.out)
    if given is None:
        _link_captures(arguments.earlier / "captures", out / "captures")
    lab = given or render_laboratory(out / "captures", arguments.size, arguments.seed, reporter, workers)
    paper = evaluate_paper(lab, out, arguments.seed, reporter, workers)
    document = {**make_paper_document(paper), "report": out / "report.html"}
    write_text(out / "report.html", render_paper_page(paper))
    write_json(out / "paper.json", document)
    return document


def _link_captures(earlier: Path, captures: Path) -> None:
    """Link the captures that an earlier run rendered, so that they are not rendered again."""
    import os
    import shutil

    if earlier.is_dir():
        shutil.copytree(earlier, captures, copy_function=os.link)


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    lines: list[str] = []
    for one in result["depth"]:
        lines.append(
            f"{one['scene']:<22} {one['by']:<32} {one['coverage']:6.1%} measured, {one['within_1mm']:6.1%} "
            f"within 1 mm, median error {one['interior_median_mm']:.3f} mm"
        )
    for row in result["dimensions"]:
        ours, theirs = row["measured_mm"]["multiview"], row["paper_table2_mm"]
        lines.append(
            f"{row['name']:<41} {row['actual_mm']:8.3f} mm, paper {theirs - row['actual_mm']:+.3f}, "
            f"here {ours - row['actual_mm']:+.3f}"
        )
    return "\n".join([*lines, f"report {result['report']}"])
