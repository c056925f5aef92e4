"""The TOML files of a commissioning's plant: cameras.toml and project.toml; and values in TOML."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.commissioning.state import CommissionSettings, CommissionState
from beltscape.commissioning.steps import BELT, CAMERAS_FILE, MOVING, RIG, find_capture
from beltscape.core.checks import is_dict, is_list_or_tuple
from beltscape.files.atomic import write_text
from beltscape.files.toml_text import read_toml


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
    return format_table("cameras", values) + format_table("cameras.devices", settings.devices)


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
    lines = [
        f"name = {format_value(settings.plant)}\nrig = {format_value(RIG)}\nempty = {format_value(BELT)}\n"
    ]
    if settings.source == "cameras":
        lines.append(format_cameras(settings))
        if settings.camera_encoder:
            lines.append(format_table("cameras.encoder", settings.camera_encoder))
        encoder = dict(settings.encoder)
    else:
        capture = find_capture(settings, MOVING)
        table = folder / capture / "encoder.csv"
        lines.append(format_table("capture", {"folder": capture}))
        encoder = dict(settings.encoder) or ({"kind": "capture"} if table.is_file() else {})
    if encoder:
        lines.append(format_table("encoder", encoder))
    lines.append(format_table("matching", {"preset": "fast", "load_mm": settings.load_mm}))
    if settings.density_kg_m3 is not None:
        lines.append(format_table("density", {"kg_m3": settings.density_kg_m3}))
    lines.append(format_table("web", {"plant": settings.plant}))
    return "\n".join(lines)


def list_differences(path: Path, text: str) -> list[str]:
    """Return a line for every answer that a project.toml which somebody has changed does not have."""
    present, wanted = _flatten(read_toml(path)), _flatten(tomllib.loads(text))
    return [
        f"{path.name}: {key} is {format_value(present[key]) if key in present else 'not there'}, "
        f"{format_value(value)} was answered; change the file, or move it away and run the step again"
        for key, value in wanted.items()
        if present.get(key) != value
    ]


def _flatten(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the values of a table and of those in it, by their keys with dots."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        found |= _flatten(value, f"{prefix}{key}.") if is_dict(value) else {prefix + key: value}
    return found


def format_table(name: str, values: Mapping[str, Any], *, is_list: bool = False) -> str:
    """Return a table in TOML, or one of a list of tables."""
    head = f"[[{name}]]" if is_list else f"[{name}]"
    return (
        "\n".join([head, *(f"{_key(key)} = {format_value(value)}" for key, value in values.items())]) + "\n"
    )


def _key(name: str) -> str:
    return (
        name if name.replace("_", "").replace("-", "").isascii() and name.isidentifier() else json.dumps(name)
    )


def format_value(value: Any) -> str:
    """Return a value in TOML, whose strings, numbers and truths are those of JSON."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(k)} = {format_value(v)}" for k, v in value.items()) + "}"
    if is_list_or_tuple(value):
        return "[" + ", ".join(map(format_value, value)) + "]"
    return json.dumps(os.fspath(value) if isinstance(value, Path) else value, ensure_ascii=False)
