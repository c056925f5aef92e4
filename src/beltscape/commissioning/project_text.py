"""The TOML files that a commissioning writes: cameras.toml, project.toml, and the material test's file."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from beltscape.commissioning import trial
from beltscape.commissioning.state import CommissionSettings, CommissionState, RunAnswer
from beltscape.commissioning.steps import BELT, CAMERAS_FILE, MOVING, RIG, TEST_FILE, find_capture, name_flow
from beltscape.core.checks import is_list_or_tuple
from beltscape.files.atomic import write_text


def format_cameras(settings: CommissionSettings) -> str:
    """Return the table [cameras] of the named devices."""
    values: dict[str, Any] = {
        "trigger": settings.trigger,
        "frames_per_s": settings.frames_per_s,
        "allowed_skew_ms": settings.allowed_skew_ms,
    }
    for key in ("exposure_us", "gain_db", "packet_size"):
        if (value := getattr(settings, key)) is not None:
            values[key] = value
    return _format_table("cameras", values) + _format_table("cameras.devices", settings.devices)


def write_cameras(state: CommissionState) -> None:
    """Write cameras.toml by the present settings; nothing where the source is not cameras, or none is named."""
    settings = state.settings
    if settings.source != "cameras" or not settings.devices:
        return
    path, text = state.folder / CAMERAS_FILE, format_cameras(settings)
    if not path.is_file() or path.read_text("utf-8") != text:
        write_text(path, text)


def format_project(folder: Path, settings: CommissionSettings) -> str:
    """Return project.toml of the plant: what was answered, and defaults for the rest."""
    lines = [f"name = {_format(settings.plant)}\nrig = {_format(RIG)}\nempty = {_format(BELT)}\n"]
    if settings.source == "cameras":
        lines.append(format_cameras(settings))
        encoder = dict(settings.encoder)
    else:
        capture = find_capture(settings, MOVING)
        table = folder / capture / "encoder.csv"
        lines.append(_format_table("capture", {"folder": capture}))
        encoder = dict(settings.encoder) or ({"kind": "capture"} if table.is_file() else {})
    if encoder:
        lines.append(_format_table("encoder", encoder))
    lines.append(_format_table("matching", {"preset": "fast", "load_mm": settings.load_mm}))
    if settings.density_kg_m3 is not None:
        lines.append(_format_table("density", {"kg_m3": settings.density_kg_m3}))
    lines.append(_format_table("web", {"plant": settings.plant}))
    return "\n".join(lines)


def write_test(state: CommissionState) -> None:
    """Write the material test's file of the runs that were answered."""
    settings = state.settings
    reference = {key: value for key, value in settings.reference.model_dump().items() if value != ""}
    head = {"name": "commissioning", "operator": settings.operator}
    lines = ["".join(f"{key} = {_format(value)}\n" for key, value in head.items() if value)]
    kinds = {"volume_reference" if run.mass_kg is None else "reference" for run in settings.runs}
    lines += [_format_table(kind, reference) for kind in sorted(kinds)]
    lines += [_format_table("runs", dict(_list_run(state, run)), is_list=True) for run in settings.runs]
    write_text(state.folder / TEST_FILE, "\n".join(lines))


def _list_run(state: CommissionState, run: RunAnswer) -> Iterator[tuple[str, Any]]:
    yield "load", run.load
    yield "flow", name_flow(run)
    if run.mass_kg is not None:
        yield "mass_kg", run.mass_kg
    else:
        yield (
            "volume_m3",
            trial.compute_true_m3(state, run) if state.settings.source == "trial" else run.volume_m3,
        )
    if run.ticket:
        yield "ticket", run.ticket


def _format_table(name: str, values: Mapping[str, Any], *, is_list: bool = False) -> str:
    head = f"[[{name}]]" if is_list else f"[{name}]"
    return "\n".join([head, *(f"{_key(key)} = {_format(value)}" for key, value in values.items())]) + "\n"


def _key(name: str) -> str:
    return (
        name if name.replace("_", "").replace("-", "").isascii() and name.isidentifier() else json.dumps(name)
    )


def _format(value: Any) -> str:
    """Return a value in TOML, whose strings, numbers and truths are those of JSON."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(k)} = {_format(v)}" for k, v in value.items()) + "}"
    if is_list_or_tuple(value):
        return "[" + ", ".join(map(_format, value)) + "]"
    return json.dumps(os.fspath(value) if isinstance(value, Path) else value, ensure_ascii=False)
