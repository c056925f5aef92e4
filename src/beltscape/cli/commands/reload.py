"""``beltscape reload project.toml``: a running plant reads its settings, rig and empty belt again."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("project", type=Path, help="project.toml of the running plant")
    parser.add_argument(
        "--list",
        action="store_true",
        help="change nothing; list every setting with when a change takes effect",
    )


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Let the run of the project take over what changed; the whole project is checked first."""
    from beltscape.service.changes import list_effects
    from beltscape.service.project import open_project
    from beltscape.service.reload_requests import request_reload

    project = open_project(arguments.project)
    if arguments.list:
        settings = [{"key": one.key, "effect": one.effect} for one in list_effects()]
        return {"project": project.path, "settings": settings}
    data = project.resolve(project.settings.data)
    return {"project": project.path, **request_reload(data)}


def summary(result: Mapping[str, Any]) -> str:
    """Return the changes, one to a line."""
    if "settings" in result:
        return "\n".join(f"{one['effect']:<8} {one['key']}" for one in result["settings"])
    lines = [f"{_format(one)}" for one in result["at_once"]]
    if result["restart"]:
        lines.append("these need a restart; until then the old values hold:")
        lines += [f"  {_format(one)}" for one in result["restart"]]
    return "\n".join(lines or ["nothing has changed"])


def _format(change: Mapping[str, str]) -> str:
    return f"{change['key']}: {change['before']} → {change['after']}"
