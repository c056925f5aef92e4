"""What is looked at now and then while a belt runs: its largest lump, and how far it runs off."""

from __future__ import annotations

import numpy as np

from beltscape.core.belt.empty_belt import Belt
from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap
from beltscape.measure.belt.edges import find_belt_edges
from beltscape.measure.lumps.lumps import measure_lumps
from beltscape.measure.lumps.settings import LumpSettings

_NAN = float("nan")


def largest_lump(
    depth: DepthMap, camera: Camera, belt: Belt, settings: LumpSettings | None = None
) -> tuple[float, float]:
    """Sieve size of the largest lump in view and its σ, mm; one that the frame cuts counts as far as it is seen.

    Where there is none: 0, with the smallest size that can be told apart as σ. NaN twice where nothing is measured.

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


def belt_offset(depth: DepthMap, camera: Camera, belt: Belt) -> tuple[float, float]:
    """How far the belt runs off to +x and its σ, mm; NaN twice where its ends cannot be seen, or nothing at all."""
    if not depth.measured.any():
        return _NAN, _NAN
    edges = find_belt_edges(depth, camera, belt)
    return edges.offset_mm, edges.sigma_mm
