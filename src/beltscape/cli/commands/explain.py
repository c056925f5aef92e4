"""``beltscape explain PROJECT TOTAL``: how a total came about, from the records and events of the history."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import add_output_folder
from beltscape.core.progress import Reporter

_MOST_LINES = 12
"""Alarms, and events, in the summary; the page has all."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "place", type=Path, metavar="PROJECT", help="project.toml, or the folder of a history"
    )
    parser.add_argument(
        "total", metavar="TOTAL", help="all, batch:17, day:2026-11-21 or 2026-11-21T08:00Z/2026-11-21T09:00Z"
    )
    parser.add_argument("--language", default="en", help="of the page: en, de, es or zh (default: en)")
    add_output_folder(parser, "folder for report.html and explanation.json (default: print the result only)")


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Explain the total."""
    from beltscape.files.atomic import write_text
    from beltscape.files.json_text import write_json
    from beltscape.pipeline.auditing.explanation import explain_total, make_explanation_document
    from beltscape.pipeline.auditing.total import parse_total
    from beltscape.report.metrology.certificate import open_metrology_texts
    from beltscape.report.metrology.explanation import render_explanation

    folder, zone, shifts = _open_place(arguments.place)
    open_metrology_texts(arguments.language, zone)
    name = parse_total(arguments.total, zone, shifts)
    document = make_explanation_document(explain_total(folder, name, reporter))
    files: dict[str, Path] = {}
    if arguments.out is not None:
        files = {"report": arguments.out / "report.html", "explanation": arguments.out / "explanation.json"}
        write_text(files["report"], render_explanation(document, arguments.language, zone))
        write_json(files["explanation"], document)
    return {**document, "time_zone": zone, "files": files}


def _open_place(place: Path) -> tuple[Path, str, Any]:
    """Return the folder of the history, time zone and shifts; those of a folder alone are UTC and none."""
    if place.is_dir():
        return place, "UTC", ()
    from beltscape.service.project import open_project

    project = open_project(place)
    production = project.settings.production
    return project.resolve(project.settings.data), production.time_zone, production.shifts


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    from beltscape.report.metrology.certificate import open_metrology_texts
    from beltscape.report.metrology.explanation import list_remarks, name_alarm, summarise_total

    texts = open_metrology_texts("en", result["time_zone"])
    lines = [summarise_total(result, texts), *list_remarks(result, texts)]
    for one in result["standings"]:
        reason = f" ({one['reason']})" if one["reason"] else ""
        length = one["valid_m"] + one["degraded_m"] + one["missing_m"]
        lines.append(f"{one['standing']:<9} {length:10.1f} m  {one['volume_m3']:10.2f} m³{reason}")
    for one in result["runs"]:
        certificate = one["provenance"].get("certificate", "") or "none"
        parts = ", ".join(
            f"{key} {value[:8]}" for key, value in one["provenance"].items() if key != "certificate"
        )
        lines.append(f"run {one['run']}: {one['volume_m3']:.2f} m³ by {parts or 'what is not recorded'}; "
                     f"certificate {certificate}")  # fmt: skip
    for one in result["alarms"][:_MOST_LINES]:
        by = f"acknowledged by {one['acknowledged_by']}" if one["acknowledged_by"] else "not acknowledged"
        lines.append(
            f"alarm {name_alarm(one['name'], 'en')}, {texts.moment(one['raised_ms'])}: {by}; {one['text']}"
        )
    for one in result["events"][:_MOST_LINES]:
        by = f" by {one['by']}" if one["by"] else ""
        lines.append(f"{one['kind']} {one['name']}, {texts.moment(one['at_ms'])}{by}: {one['text']}")
    more = sum(max(0, len(result[name]) - _MOST_LINES) for name in ("alarms", "events"))
    lines += [f"{more} more alarms and events are in --json and --out"] if more else []
    return "\n".join([*lines, *(f"{name:<6} {path}" for name, path in result["files"].items())])
