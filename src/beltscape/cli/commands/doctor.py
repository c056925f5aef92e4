"""``beltscape doctor``: what is installed, and whether this machine suits the job."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "--data",
        type=Path,
        default=Path(),
        metavar="DIR",
        help="folder whose disk is tried; default: this one",
    )


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Make all checks; a warning does not change the exit code."""
    from beltscape.pipeline.installation import check_machine, check_software

    checks = [*check_software(), *check_machine(arguments.data)]
    return {
        "checks": [
            {"name": one.name, "state": one.state, "found": one.found, "fix": one.fix} for one in checks
        ]
    }


def summary(result: Mapping[str, Any]) -> str:
    """Return one line per check, and the fix below it where there is one."""
    lines: list[str] = []
    for one in result["checks"]:
        lines.append(f"{one['state']:<8} {one['name']:<16} {one['found']}")
        if one["fix"]:
            lines.append(f"{'':<8} {'':<16} → {one['fix']}")
    return "\n".join(lines)
