"""Periodic checks of a running belt: its largest lump, and its lateral offset."""

from __future__ import annotations

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.empty_belt import Belt
from beltscape.core.geometry.camera import Camera
from beltscape.measure.belt.edges import find_belt_edges
from beltscape.measure.lumps.lumps import measure_lumps
from beltscape.measure.lumps.settings import LumpSettings

_NAN = float("nan")


def measure_largest_lump(
    depth: DepthMap, camera: Camera, belt: Belt, settings: LumpSettings | None = None
) -> tuple[float, float]:
    """Return sieve size and σ, mm, of the largest lump in view; a lump cut by the frame counts by its visible part.

    Without a lump the size is 0 and σ the smallest resolved size. Both are NaN where nothing is measured.

    Raises
    ------
    InputError
        if the depth map is not the camera's size.
    """
    found = measure_lumps(depth, camera, settings or LumpSettings(), belt)
    if not np.isfinite(found.cell_mm):
        return _NAN, _NAN
    largest = max(found.lumps, key=lambda lump: lump.size_mm, default=None)
    return (0.0, found.smallest_mm) if largest is None else (largest.size_mm, largest.sigma_mm)


def measure_belt_offset(depth: DepthMap, camera: Camera, belt: Belt) -> tuple[float, float]:
    """Return the belt's lateral offset towards +x and its σ, mm; NaN where its edges are not visible."""
    if not depth.measured.any():
        return _NAN, _NAN
    edges = find_belt_edges(depth, camera, belt)
    return edges.offset_mm, edges.sigma_mm
