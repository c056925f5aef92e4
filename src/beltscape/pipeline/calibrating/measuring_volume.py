"""Reading of the measuring volume over a belt: from a plan, a learned belt, or the project that names one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from beltscape.calibration.assessment.coverage import MeasuringVolume
from beltscape.core.arrays import Array
from beltscape.core.errors import InputError
from beltscape.files.belt_json import read_belt
from beltscape.files.toml_text import read_toml, validate
from beltscape.pipeline.live.project import MatchingSettings
from beltscape.plan.plan import make_plan
from beltscape.plan.settings import PlanSettings

ACROSS, ALONG, HEIGHTS = 41, 31, 3
"""Points of a volume in its three directions."""
PLAN_TABLES = frozenset(PlanSettings.model_fields)
"""Keys of plan.toml; a TOML file without any of them is a project.toml."""


def read_measuring_volume(path: Path) -> MeasuringVolume:
    """Return the volume over a belt that a rig is to measure, in the core frame.

    ``path`` is a plan.toml, whose core camera looks vertically down on the belt's middle; the belt.json of a rig
    whose core camera stands where it stood; or a project.toml that names a belt.json as its empty belt.

    Raises
    ------
    InputError
        With one line that names the file and the fix.
    """
    if path.suffix == ".json":
        return _read_belt_volume(path, MatchingSettings().load_mm)
    if path.suffix != ".toml":
        raise InputError(
            f"{path}: give a plan.toml, a project.toml or a belt.json, which tell where the belt is"
        )
    settings = read_toml(path)
    if PLAN_TABLES & settings.keys():
        return _plan_volume(path, validate(path, PlanSettings, settings))
    matching = validate(path, MatchingSettings, settings.get("matching", {}))
    belt = path.parent / str(settings.get("empty", "belt.json"))
    if not belt.is_file():
        raise InputError(
            f"{path}: empty = {str(belt)!r}: no such file; for a first calibration give the plan.toml instead"
        )
    return _read_belt_volume(belt, matching.load_mm)


def _read_belt_volume(path: Path, load_mm: float) -> MeasuringVolume:
    belt, _ = read_belt(path)
    x = np.linspace(*belt.across_mm, ACROSS)
    y = np.linspace(*belt.along_mm, ALONG)
    floor, height = belt.surface_mm(x, y), np.linspace(0, load_mm, HEIGHTS)
    across, along = np.meshgrid(x, y)
    points = np.concatenate([np.stack([across, along, floor + h], axis=-1).reshape(-1, 3) for h in height])
    return MeasuringVolume(
        f"the belt of {path.name}", belt.belt_from_core.inverse().apply(points), is_given=True
    )


def _plan_volume(path: Path, settings: PlanSettings) -> MeasuringVolume:
    planned = make_plan(settings).planned
    length_mm = max(settings.belt.width_mm, planned.core_from_world.translation_mm[2])
    points = np.concatenate([_make_plane(width, length_mm, z) for z, width in settings.belt.planes])
    points = planned.core_from_world.apply(points)
    tolerance_mm = settings.precision.calibration_sigma_mm or None
    return MeasuringVolume(f"the belt of {path.name}", points, is_given=True, tolerance_mm=tolerance_mm)


def _make_plane(width_mm: float, length_mm: float, height_mm: float) -> Array:
    x, y = np.linspace(-width_mm / 2, width_mm / 2, ACROSS), np.linspace(-length_mm, length_mm, 2 * ALONG)
    across, along = np.meshgrid(x, y)
    return np.stack([across, along, np.full_like(across, height_mm)], axis=-1).reshape(-1, 3)
