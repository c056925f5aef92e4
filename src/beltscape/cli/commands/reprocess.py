"""``beltscape reprocess SOURCE --project project.toml --out STORE``: measures recordings again, on many workers."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import add_output_folder, add_workers
from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "source",
        help="recordings: a folder, an archive of a day (zip, tar), or a URL such as s3://bucket/plant7",
    )
    parser.add_argument(
        "--project",
        type=Path,
        required=True,
        help="project.toml with the rig, empty belt and settings to use",
    )
    add_workers(parser)
    parser.add_argument(
        "--piece-frames",
        type=int,
        metavar="N",
        help="most frames of a piece, the unit of work (default: 600); it decides the records' last digits",
    )
    add_output_folder(
        parser, "store: history, report.html, reprocessing.json; another run goes on in it", required=True
    )
    parser.set_defaults(output="history")


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Measure the recordings that are not measured yet, and join the ledger."""
    from beltscape.core.errors import SettingsError
    from beltscape.reprocessing.pieces import PIECE_FRAMES
    from beltscape.reprocessing.run import reprocess
    from beltscape.service.project import open_project
    from beltscape.workers.options import WorkerOptions

    frames = PIECE_FRAMES if arguments.piece_frames is None else arguments.piece_frames
    if not 20 <= frames <= 1_000_000:
        raise SettingsError(f"--piece-frames {frames}: must be between 20 and 1000000")
    options = WorkerOptions(arguments.workers, arguments.address)
    project = open_project(arguments.project)
    result = reprocess(arguments.source, project, arguments.out, options, reporter, frames)
    return {**result, **{key: arguments.out / result[key] for key in ("history", "report")}}


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    from beltscape.reprocessing.report import summarise

    lines = [summarise(result)]
    if not result["changed"]:
        lines.append("nothing to do: everything was measured by an earlier run")
    work = result["work"]
    if result["changed"] and work["frames_per_s"] is not None:
        lines.append(
            f"{result['measured_now']} of {result['pieces']} pieces measured now: "
            f"{work['frames_per_s']:.2f} frames/s on {work['workers']} workers, busy {100 * work['efficiency']:.0f} %"
        )
    lines += [f"not read: {one['name']}: {one['reason']}" for one in result["unreadable"]]
    lines += [f"not measured: {one['piece']}: {one['reason']}" for one in result["failed"]]
    return "\n".join([*lines, f"history {result['history']}", f"report {result['report']}"])
