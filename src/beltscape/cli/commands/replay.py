"""``beltscape replay project.toml --out DIR``: runs the live system on a recorded capture."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import add_output_folder
from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("project", type=Path, help="project.toml of the plant")
    parser.add_argument(
        "--capture", type=Path, help="recorded capture (default: the project's [capture] folder)"
    )
    parser.add_argument(
        "--speed",
        choices=("full", "real"),
        default="full",
        help="full: as fast as it can be measured; real: at the pace of the recording",
    )
    parser.add_argument("--page", action="store_true", help="serve the operator's page during the replay")
    add_output_folder(
        parser,
        "folder for the replay's history; the plant's own is not changed",
        required=True,
        owner=("capture",),
    )
    parser.set_defaults(output="history")  # a second replay continues it


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Replay the capture and return the summary of the run."""
    from beltscape.pipeline.live.assembly import RunOptions
    from beltscape.service.hosting import log_to_stderr, make_stop_event
    from beltscape.service.plant import run_plant
    from beltscape.service.project import open_project, substitute_capture

    project = substitute_capture(open_project(arguments.project), arguments.capture)
    log_to_stderr()
    options = RunOptions(data=arguments.out, paced=arguments.speed == "real", record=False)
    return run_plant(project, options, make_stop_event(), page=arguments.page)


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    from beltscape.service.hosting import format_summary

    return format_summary(result)
