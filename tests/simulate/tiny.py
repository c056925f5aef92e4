"""Scenarios that render in a second: three cameras of 320 × 264 px over a short belt with a few rocks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from beltscape.simulate.scenario import Scenario

TINY: dict[str, Any] = {
    "rig": {"size_px": (320, 264), "pitch_um": 3.45 * 7.65, "scale": 1.0, "auxiliaries": 2},
    "render": {"oversample": 1, "passes": 1, "ambient_samples": 1},
    "projector": {"size_px": (320, 200)},
    "heap": {"rocks": 3, "fines": {"along_mm": (-150.0, 150.0), "cell_mm": 12.0}},
}

CUBES = {"file": str(Path(__file__).with_name("cubes.toml"))}
"""A module of two cubes, whose scene is made in a tenth of the time of the paper's module with its spheres."""


def tiny(kind: str, **more: Any) -> Scenario:
    """A small scenario; ``more`` goes before what makes it small, table by table."""
    values = {**TINY, "kind": kind}
    for key, value in more.items():
        values[key] = {**TINY.get(key, {}), **value} if isinstance(value, dict) else value
    return Scenario.model_validate(values)
