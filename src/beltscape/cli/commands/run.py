"""``beltscape run project.toml``: measures live until it is stopped."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("project", type=Path, help="project.toml: cameras, rig, belt, alarms, page")
    parser.add_argument("--no-page", action="store_true", help="measure and record only")
    parser.add_argument(
        "--learn-images",
        action="store_true",
        help="learn anew what sound images show, after cleaning or work at lenses and lights",
    )
    parser.add_argument(
        "--check",
        action="store_true",
        help="open everything that a run would open, report the result, and stop",
    )


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Run until SIGINT or SIGTERM, or to the end of a capture."""
    from beltscape.pipeline.live.assembly import RunOptions
    from beltscape.service.check import check_plant
    from beltscape.service.data_rights import restrict_rights
    from beltscape.service.hosting import log_to_stderr, make_stop_event, make_watchdog
    from beltscape.service.plant import run_plant
    from beltscape.service.project import open_project

    project = open_project(arguments.project)
    if arguments.check:
        parts = check_plant(project, reporter, page=not arguments.no_page)
        settings = project.settings.model_dump(mode="json")
        return {"project": project.path, "settings": settings, "checked": True, "parts": parts}
    log_to_stderr()
    options = RunOptions(
        data=project.resolve(project.settings.data),
        heartbeat=make_watchdog(),
        learn_images=arguments.learn_images,
    )
    with restrict_rights(options.data):
        return run_plant(project, options, make_stop_event(), page=not arguments.no_page)


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    if result.get("checked"):
        parts = (f"{name:<8} {line}" for name, line in result["parts"].items())
        return "\n".join([f"{result['project']}: the settings fit", *parts])
    from beltscape.service.hosting import format_summary

    return format_summary(result)
