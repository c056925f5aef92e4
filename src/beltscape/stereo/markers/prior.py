"""The coarse prior that follows from the markers: where the surface lies in each region, without any search."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Reporter
from beltscape.core.rig import Rig
from beltscape.kernels import Kernels, load
from beltscape.stereo.markers.agreement import agree, seen_in_place
from beltscape.stereo.markers.grid import SIDE, MarkerGrid, find_marker_grid
from beltscape.stereo.markers.regions import region_labels

RELIEF_MM = 100.0
"""How far from its marker's depth the surface of a region may lie, unless told: a lump larger than most."""
_FEWEST = 3
"""With fewer markers measured there is no prior."""


@dataclass(frozen=True, slots=True, eq=False)
class DepthPrior:
    """Within which depths a matcher has to look, region by region, on the core's undistorted grid."""

    labels: NDArray[np.int8]
    """(H, W) int8: region of each pixel, 4·row + column; −1 outside the pattern."""
    marker_mm: NDArray[np.float64]
    """(16,) depth of each region's marker along the core's optical axis; NaN where not measured."""
    near_mm: NDArray[np.float64]
    """(16,) nearest depth to look at."""
    far_mm: NDArray[np.float64]
    """(16,) farthest depth to look at."""

    def interval_mm(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(H, W) float32 nearest and farthest depth per pixel; NaN outside the pattern, where nothing is known."""
        outside = self.labels < 0
        return tuple(  # pyright: ignore[reportReturnType]
            np.where(outside, np.nan, ends[self.labels]).astype(np.float32)
            for ends in (self.near_mm, self.far_mm)
        )

    def range_mm(self) -> tuple[float, float]:
        """(near, far) over all regions."""
        return float(self.near_mm.min()), float(self.far_mm.max())


def find_grids(frame_set: FrameSet, rig: Rig, reporter: Reporter) -> dict[str, MarkerGrid]:
    """The markers of every camera of a frame, with the same rows and columns in all of them.

    Cameras that show no grid, or one that does not fit the others', are left out and named in a warning.
    """
    seen: dict[str, MarkerGrid] = {}
    for name in rig.cameras:
        if name not in frame_set.images:
            continue
        grid = find_marker_grid(frame_set.images[name])
        if grid is None:
            reporter.warn(f"frame {frame_set.frame}: no speckle markers in the image of {name}")
        else:
            seen[name] = grid
    agreed = agree(seen, rig)
    for name in seen:
        if name not in agreed:
            reporter.warn(f"frame {frame_set.frame}: the markers {name} sees do not fit the other cameras'")
    return agreed


def depth_prior(
    grids: Mapping[str, MarkerGrid], rig: Rig, *, relief_mm: float = RELIEF_MM, kernels: Kernels | None = None
) -> DepthPrior:
    """Depth interval of each region from the markers that the core and at least one auxiliary see.

    A marker that cameras see in places that do not meet (its disc is torn by an edge and they see different parts)
    is not believed. The interval of a region spans the depths of its own and its neighbours' markers, with
    ``relief_mm`` before and behind; where its own was not measured, the neighbours'; where those neither, all.

    Parameters
    ----------
    grids
        By camera, from `find_grids`, in the images as they are.
    relief_mm
        How far the surface may stand out before, or lie behind, the markers.

    Raises
    ------
    ReconstructionError
        When the core's markers were not found, or fewer than three could be measured.
    """
    if rig.core not in grids:
        raise ReconstructionError(f"no markers in the image of the core camera {rig.core}; no region prior")
    points, _ = seen_in_place(grids, rig, kernels or load())
    depth = points[:, 2].reshape(SIDE, SIDE)
    measured = np.isfinite(depth)
    if measured.sum() < _FEWEST:
        raise ReconstructionError(
            f"only {int(measured.sum())} of {SIDE * SIDE} markers are seen by the core and another camera in places "
            f"that meet; a region prior needs {_FEWEST}"
        )
    near, far = np.empty((SIDE, SIDE)), np.empty((SIDE, SIDE))
    for row in range(SIDE):
        for column in range(SIDE):
            around = (slice(max(row - 1, 0), row + 2), slice(max(column - 1, 0), column + 2))
            known = depth[around] if measured[around].any() else depth
            near[row, column], far[row, column] = np.nanmin(known) - relief_mm, np.nanmax(known) + relief_mm
    return DepthPrior(
        labels=region_labels(grids[rig.core].undistorted(rig.core_camera)),
        marker_mm=depth.reshape(-1),
        near_mm=np.maximum(near, 1.0).reshape(-1),
        far_mm=far.reshape(-1),
    )
