"""Depth bounds of the pattern's regions, from the depths of their markers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.kernels import Kernels, load
from beltscape.stereo.markers.correspondence import align_grids, triangulate_markers
from beltscape.stereo.markers.grid import SIDE, MarkerGrid, detect_marker_grid
from beltscape.stereo.markers.regions import label_regions

RELIEF_MM = 100.0
"""Default for the largest distance of a surface from its markers' depths: more than the height of most lumps."""
_MIN_MARKERS = 3
"""Least number of measured markers."""


@dataclass(frozen=True, slots=True, eq=False)
class RegionDepths:
    """Range of depths of each region, on the core's undistorted grid."""

    labels: NDArray[np.int8]
    """(H, W) int8: region of each pixel, 4·row + column; −1 outside the pattern."""
    marker_mm: NDArray[np.float64]
    """(16,) depth of each region's marker along the core's optical axis; NaN where not measured."""
    near_mm: NDArray[np.float64]
    """(16,) nearest depth of a region's surface."""
    far_mm: NDArray[np.float64]
    """(16,) farthest depth of a region's surface."""

    def rasterise(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return (H, W) float32 the nearest and the farthest depth of each pixel, mm; NaN outside the pattern."""
        outside = self.labels < 0
        return tuple(  # pyright: ignore[reportReturnType]
            np.where(outside, np.nan, ends[self.labels]).astype(np.float32)
            for ends in (self.near_mm, self.far_mm)
        )

    def range_mm(self) -> tuple[float, float]:
        """Return (near, far) over all regions."""
        return float(self.near_mm.min()), float(self.far_mm.max())


def detect_marker_grids(frame_set: FrameSet, rig: Rig, reporter: Reporter) -> dict[str, MarkerGrid]:
    """Return the marker grids of a frame's cameras, with the same rows and columns in all of them.

    Cameras without a grid, or with one that contradicts the others', are left out and named in a warning.
    """
    detected: dict[str, MarkerGrid] = {}
    for name in rig.cameras:
        if name not in frame_set.images:
            continue
        grid = detect_marker_grid(frame_set.images[name])
        if grid is None:
            reporter.warn(f"frame {frame_set.frame}: no speckle markers in the image of {name}")
        else:
            detected[name] = grid
    aligned = align_grids(detected, rig)
    for name in detected:
        if name not in aligned:
            reporter.warn(f"frame {frame_set.frame}: the markers {name} sees do not fit the other cameras'")
    return aligned


def bound_region_depths(
    grids: Mapping[str, MarkerGrid], rig: Rig, *, relief_mm: float = RELIEF_MM, kernels: Kernels | None = None
) -> RegionDepths:
    """Return the depth bounds of each region from the markers that the core and at least one auxiliary see.

    A marker whose rays do not intersect is not used: its disc is torn by an edge, and cameras see different parts.
    The bounds of a region span the measured depths of its own and its neighbours' markers, extended by
    ``relief_mm`` to both sides; without any, they span all measured depths.

    Parameters
    ----------
    grids
        By camera, from `detect_marker_grids`, in distorted pixels.
    relief_mm
        Largest distance of the surface in front of and behind the markers.

    Raises
    ------
    ReconstructionError
        When the core's markers were not detected, or fewer than three could be measured.
    """
    if rig.core not in grids:
        raise ReconstructionError(
            f"no markers in the image of the core camera {rig.core}; depths of regions need them"
        )
    points, _ = triangulate_markers(grids, rig, kernels or load())
    depth = points[:, 2].reshape(SIDE, SIDE)
    measured = np.isfinite(depth)
    if measured.sum() < _MIN_MARKERS:
        raise ReconstructionError(
            f"only {int(measured.sum())} of {SIDE * SIDE} markers are seen consistently by the core and another "
            f"camera; depths of regions need {_MIN_MARKERS}"
        )
    near, far = np.empty((SIDE, SIDE)), np.empty((SIDE, SIDE))
    for row in range(SIDE):
        for column in range(SIDE):
            around = (slice(max(row - 1, 0), row + 2), slice(max(column - 1, 0), column + 2))
            depths = depth[around] if measured[around].any() else depth
            near[row, column], far[row, column] = np.nanmin(depths) - relief_mm, np.nanmax(depths) + relief_mm
    return RegionDepths(
        labels=label_regions(grids[rig.core].undistort(rig.core_camera)),
        marker_mm=depth.reshape(-1),
        near_mm=np.maximum(near, 1.0).reshape(-1),
        far_mm=far.reshape(-1),
    )
