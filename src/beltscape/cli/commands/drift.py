"""``beltscape drift PROJECT``: how the rig has drifted since it was calibrated, and the proposal, taken or undone."""

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
    action = parser.add_mutually_exclusive_group()
    action.add_argument(
        "--take", type=int, metavar="NUMBER", help="replace the rig by the proposal of the newest estimate"
    )
    action.add_argument("--undo", action="store_true", help="put back the rig before the last one taken")
    parser.add_argument(
        "--by", default="", metavar="NAME", help="who takes or undoes it (default: the user of this machine)"
    )
    parser.add_argument("--language", default="en", help="of the page: en, de, es or zh (default: en)")
    add_output_folder(parser, "folder for report.html and drift.json (default: print the result only)")


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Read the drift, or change the rig."""
    from beltscape.files.atomic import write_text
    from beltscape.files.json_text import write_json
    from beltscape.pipeline.calibrating.drift import assess_drift, make_drift_document
    from beltscape.pipeline.calibrating.rig_changes import read_changes, take_proposal, undo_change
    from beltscape.report.metrology.certificate import open_metrology_texts
    from beltscape.report.metrology.drift import render_drift
    from beltscape.service.project import open_project

    project = open_project(arguments.project)
    zone = project.settings.production.time_zone
    open_metrology_texts(arguments.language, zone)
    data, rig = project.resolve(project.settings.data), project.resolve(project.settings.rig)
    if arguments.undo:
        change = undo_change(data, rig, _get_user(arguments))
        return _audit(project, change.action, change.by, change.detail)
    found = assess_drift(project, reporter)
    if arguments.take is not None:
        change = take_proposal(data, found, arguments.take, _get_user(arguments))
        return _audit(project, change.action, change.by, change.detail)
    document = {**make_drift_document(found), "changes": read_changes(data)}
    files: dict[str, Path] = {}
    if arguments.out is not None:
        files = {"report": arguments.out / "report.html", "drift": arguments.out / "drift.json"}
        write_text(files["report"], render_drift(document, arguments.language, zone))
        write_json(files["drift"], document)
    return {**document, "files": files}


def _get_user(arguments: argparse.Namespace) -> str:
    import getpass

    return arguments.by or getpass.getuser()


def _audit(project: Any, action: str, by: str, detail: Mapping[str, str | int]) -> Mapping[str, Any]:
    """Add the change to the audit log of the plant; return the result."""
    from beltscape.service.access import Access

    access = Access(project.resolve(project.settings.data), project.settings.web.access)
    access.audit.write(f"rig {action}", f"{by} on this machine", "beltscape drift", detail)
    return {"action": action, "by": by, **detail, "rig": project.resolve(project.settings.rig)}


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    if "action" in result:
        return (
            f"{result['rig']}: estimate {result['estimate']} {result['action']} by {result['by']}; a running plant "
            "takes it over by beltscape reload"
        )
    from beltscape.report.metrology.certificate import open_metrology_texts
    from beltscape.report.metrology.drift import list_cameras, list_drift_notes, summarise_drift

    texts = open_metrology_texts("en", "UTC")
    lines = [summarise_drift(result, texts), *list_cameras(result, texts)]
    lines += [f"note: {line}" for line in list_drift_notes(result, texts)]
    if result["has_proposal"]:
        lines.append(f"take it: beltscape drift PROJECT --take {result['newest']}")
    return "\n".join([*lines, *(f"{name:<6} {path}" for name, path in result["files"].items())])
