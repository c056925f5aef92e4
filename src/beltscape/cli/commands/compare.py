"""``beltscape compare A B``: two measurements of the same belt: flow, totals, where and why they differ."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import add_output_folder
from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    history = "data folder of a run or replay (it may be running), or a re-processing's store"
    parser.add_argument("a", type=Path, metavar="A", help=f"the first history: {history}")
    parser.add_argument("b", type=Path, metavar="B", help="the second history; differences are B - A")
    add_output_folder(parser, "folder for report.html and comparison.json (default: print the result only)")


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Compare both histories."""
    from beltscape.core.progress import RecordingReporter
    from beltscape.files.atomic import write_text
    from beltscape.files.json_text import write_json
    from beltscape.reprocessing.comparison.comparison import compare_histories
    from beltscape.reprocessing.comparison.document import make_document
    from beltscape.reprocessing.comparison.page import render_comparison
    from beltscape.reprocessing.comparison.texts import summarise

    recording = RecordingReporter(reporter)
    comparison = compare_histories(arguments.a, arguments.b, recording)
    document = make_document(comparison)
    files: dict[str, Path] = {}
    if arguments.out is not None:
        files = {"report": arguments.out / "report.html", "comparison": arguments.out / "comparison.json"}
        write_text(files["report"], render_comparison(comparison, warnings=recording.warnings))
        write_json(files["comparison"], document)
    return {**document, "files": files, "summary": summarise(comparison)}


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    files = [str(path) for path in result["files"].values()]
    return "\n".join([result["summary"], *files])
