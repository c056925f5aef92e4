"""Comparison of the rig with which the empty belt was reconstructed with the one in use."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.files.rig_json import read_rig

_OTHER_RAD = 1.5e-3
"""Another rig: 1 px at 600 px of focal length; calibrations of one rig differ by a tenth of it."""
_MOVED_RAD = 3e-4
"""The camera has moved, or the calibration was repeated, since the empty belt was reconstructed."""
_GRID = 5
"""Rows and columns of the points that are compared."""


def require_same_rig(empty: Path, rig: Rig, depth_mm: float, reporter: Reporter) -> None:
    """Compare the auxiliaries' poses with those of the rig.json beside the empty belt's frames, if there is one.

    Raises
    ------
    InputError
        When they are those of another rig.
    """
    path = _find_rig(empty)
    if path is None:
        return
    learned = read_rig(path)
    angles = {
        name: _compute_angle(rig, learned, name, depth_mm)
        for name in rig.auxiliaries
        if name in learned.auxiliaries
    }
    if not angles:
        return
    name = max(angles, key=lambda each: angles[each])
    degrees = np.rad2deg(angles[name])
    differs = f"{empty}: its rig.json and the rig given differ by {degrees:.2f}° in the view of {name}"
    if angles[name] > _OTHER_RAD:
        raise InputError(
            f"{differs}: it was reconstructed with another rig; reconstruct the empty belt with the rig.json given "
            "here, or give the rig.json that belongs to it"
        )
    if angles[name] > _MOVED_RAD:
        reporter.warn(f"{differs}; reconstruct the empty belt again with the rig.json given here")


def _find_rig(empty: Path) -> Path | None:
    """Return the rig.json of a reconstruction or of one of its frames; None for a belt.json."""
    if empty.is_file():
        return None
    return next((path for path in (empty / "rig.json", empty.parent / "rig.json") if path.is_file()), None)


def _compute_angle(rig: Rig, other: Rig, name: str, depth_mm: float) -> float:
    """Return the RMS angle between the directions in which two rigs' auxiliary sees points at a depth, rad."""
    core = rig.core_camera
    width, height = core.size_px
    u, v = np.meshgrid(np.linspace(0, width - 1, _GRID), np.linspace(0, height - 1, _GRID))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    rays: NDArray[np.float64] = (pixels - core.center_px) / core.focal_px
    points = np.concatenate([rays, np.ones((len(rays), 1))], axis=1) * depth_mm
    directions = [_normalise(each.cam_from_core[name].apply(points)) for each in (rig, other)]
    difference = directions[0] - directions[1]
    return float(np.sqrt(3 * np.mean(difference * difference)))


def _normalise(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (N, 3) at the length 1."""
    return points / np.linalg.norm(points, axis=1, keepdims=True)
