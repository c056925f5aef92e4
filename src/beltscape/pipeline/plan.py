"""The settings of a plan, and its files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.files.atomic import ensure_output_folder, write_text
from beltscape.files.json_text import write_json
from beltscape.files.rig_json import write_rig
from beltscape.files.toml_text import read_toml, validate
from beltscape.plan.plan import Plan, plan_to_document
from beltscape.plan.settings import PlanSettings
from beltscape.report.plan import render_plan_page


def read_plan_settings(path: Path | None, overrides: Mapping[str, Any]) -> PlanSettings:
    """Read settings from plan.toml, where given; ``overrides`` take precedence over the file.

    ``overrides`` has the file's form: a value by key, tables as mappings.

    Raises
    ------
    InputError
        With one line that names the key, the value and the permitted values.
    """
    values = read_toml(path) if path else {}
    for key, value in overrides.items():
        base = values.get(key)
        if isinstance(value, Mapping) and (base is None or isinstance(base, dict)):
            values[key] = {**(base or {}), **value}
        else:
            values[key] = value
    return validate(path or Path("plan"), PlanSettings, values)


def write_plan(out: Path, plan: Plan) -> None:
    """Write plan.json, rig.json (nominal) and report.html."""
    ensure_output_folder(out)
    write_json(out / "plan.json", {**plan_to_document(plan), "warnings": list(plan.warnings)})
    write_rig(out / "rig.json", plan.planned.rig)
    write_text(out / "report.html", render_plan_page(plan))
