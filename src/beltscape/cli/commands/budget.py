"""``beltscape budget PROJECT [TOTAL]``: the uncertainty of the paid tonne on one page, and what would lower it."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.cli.arguments import add_output_folder
from beltscape.core.errors import SettingsError
from beltscape.core.progress import Reporter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("project", type=Path, help="project.toml of the plant")
    parser.add_argument(
        "total", nargs="?", default="all", metavar="TOTAL",
        help="all (default), year:2026, day:2026-11-21, batch:17 or 2026-11-21T08:00Z/2026-11-21T09:00Z",
    )  # fmt: skip
    parser.add_argument(
        "--moisture-sigma",
        type=float,
        default=0.0,
        metavar="PERCENT",
        help="standard deviation of the moisture, where the dry tonne is paid",
    )
    parser.add_argument("--language", default="en", help="of the page: en, de, es or zh (default: en)")
    add_output_folder(parser, "folder for report.html and budget.json (default: print the result only)")


def run(arguments: argparse.Namespace, reporter: Reporter) -> Mapping[str, Any]:
    """Compute the budget."""
    from beltscape.files.atomic import write_text
    from beltscape.files.json_text import write_json
    from beltscape.pipeline.auditing.paid_tonne import (
        PaidTonneOptions,
        compute_plant_budget,
        make_budget_document,
    )
    from beltscape.pipeline.auditing.total import parse_total
    from beltscape.report.metrology.budget import render_budget
    from beltscape.report.metrology.certificate import open_metrology_texts
    from beltscape.service.project import open_project

    if not 0 <= arguments.moisture_sigma <= 20:
        raise SettingsError(f"--moisture-sigma {arguments.moisture_sigma:g}: must be 0 to 20 percent")
    project = open_project(arguments.project)
    production = project.settings.production
    open_metrology_texts(arguments.language, production.time_zone)
    name = parse_total(arguments.total, production.time_zone, production.shifts)
    options = PaidTonneOptions(arguments.moisture_sigma)
    document = make_budget_document(compute_plant_budget(project, name, options))
    files: dict[str, Path] = {}
    if arguments.out is not None:
        files = {"report": arguments.out / "report.html", "budget": arguments.out / "budget.json"}
        write_text(files["report"], render_budget(document, arguments.language, production.time_zone))
        write_json(files["budget"], document)
    return {**document, "files": files}


def summary(result: Mapping[str, Any]) -> str:
    """Return the result in a few lines."""
    from beltscape.report.metrology.budget import list_advice, list_notes, summarise_budget
    from beltscape.report.metrology.certificate import open_metrology_texts

    texts = open_metrology_texts("en", "UTC")
    lines = [summarise_budget(result, texts)]
    for one in result["budget"]:
        share = f"{100 * one['sigma'] / (abs(result['amount']) or 1):.3f} %"
        name = texts("part_name." + one["key"])
        lines.append(f"{name:<40} {one['sigma']:12.4g} {result['unit']}  {share}")
    lines += [f"lower it: {line}" for line in list_advice(result, texts)[:1]]
    lines += [f"note: {line}" for line in list_notes(result, texts)]
    return "\n".join([*lines, *(f"{name:<6} {path}" for name, path in result["files"].items())])
