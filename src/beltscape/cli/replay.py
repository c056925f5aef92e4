"""``beltscape replay project.toml --out DIR``: a recorded capture through the running system."""

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
        help="as fast as it can be measured, or as it was taken",
    )
    parser.add_argument("--page", action="store_true", help="serve the operator's page meanwhile")
    add_output_folder(
        parser, "folder for its history; the plant's stays as it is", required=True, owner=("capture",)
    )
    parser.set_defaults(output="history")  # a second replay goes on with it


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Replay it, and write what was format_summary."""
    from beltscape.pipeline.live.assembly import Ways
    from beltscape.service.lifecycle import log_to_stderr, make_stop_event
    from beltscape.service.plant import run_plant
    from beltscape.service.project import open_project, substitute_capture

    project = substitute_capture(open_project(arguments.project), arguments.capture)
    log_to_stderr()
    ways = Ways(data=arguments.out, paced=arguments.speed == "real", record=False)
    return run_plant(project, ways, make_stop_event(), page=arguments.page)


def summary(result: Mapping[str, Any]) -> str:
    """The result in a few lines."""
    from beltscape.service.lifecycle import format_summary

    return format_summary(result)
