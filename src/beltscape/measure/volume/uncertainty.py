"""The contributions to a volume's standard uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.depth import DepthMap
from beltscape.core.empty_belt import Belt
from beltscape.core.geometry.camera import Camera
from beltscape.measure.holes import Filled
from beltscape.measure.volume.load import Box, IntegrationWeights, Load

STEP_SLOPE = float(np.tan(np.deg2rad(60.0)))
"""A surface steeper than this slope is a step."""
EDGE_PX = 0.1
"""σ of the position of steps, in pixels, common to all: a matcher's bias at edges is the same at all of them."""
_COMMON_SHARE = 0.2
"""Share of the holes' σ that is common to all holes, because one network filled them all and occluded parts are
alike; set on captures that the networks were not trained on."""
_PATCH_CELLS = 8
"""Errors within a hole are correlated only within blocks of this side, since the holes of a heap are connected."""


@dataclass(frozen=True, slots=True)
class VolumeSigma:
    """Contributions to a volume's uncertainty, one standard deviation each, mm³."""

    noise_mm3: float
    """Noise of the loaded depth map, correlated over patches as large as on the empty belt."""
    belt_mm3: float
    """Uncertainty of the empty belt's cross-section and deviation."""
    holes_mm3: float
    """Uncertainty of the interpolated cells: fully correlated within a hole's block, a share common to all."""
    edges_mm3: float
    """The vertical area of all steps times a tenth of a pixel, common to the whole box."""
    drift_mm3: float
    """Slow errors of the depth map on the empty belt and of cameras that moved, common to the whole box."""
    false_depths_mm3: float = 0.0
    """Depths that may be false, by their confidence: where they are, they share their sign."""
    scale_mm3: float = 0.0
    """The size of the calibration board, by its certificate: three times its relative σ, for lengths in all three
    directions are measured by it."""
    unseen_mm3: float = 0.0
    """What the load may carry where nothing bounds it: the heights of the box that are extrapolated, and beside a box
    that covers only part of the belt's width those at its sides."""

    @property
    def total_mm3(self) -> float:
        """Return the root of the sum of squares."""
        parts = (
            self.noise_mm3,
            self.belt_mm3,
            self.holes_mm3,
            self.edges_mm3,
            self.drift_mm3,
            self.false_depths_mm3,
            self.scale_mm3,
            self.unseen_mm3,
        )
        return float(np.sqrt(sum(part**2 for part in parts)))


def compute_volume_sigma(
    load: Load,
    filled: Filled,
    weights: IntegrationWeights,
    belt: Belt,
    factor: NDArray[np.float64] | None = None,
) -> VolumeSigma:
    """Return the contributions to σ of the weighted integral of ``filled``.

    ``factor`` (Ny, Nx), where given, multiplies the weights, as for moments of the load.
    """
    grid = load.grid
    cell_mm = grid.cell_mm
    weight = np.outer(weights.along, weights.across)
    if factor is not None:
        weight = weight * factor
    patch_mm2 = (belt.correlation_px * cell_mm) ** 2
    patch_cells = max(patch_mm2 / cell_mm**2, 1.0)
    noise = np.sqrt(np.sum((weight * np.nan_to_num(load.noise_mm)) ** 2) * patch_cells)
    belt_sigma = _compute_belt_sigma(weight, belt.surface_sigma_mm(grid.x_mm, grid.y_mm), grid.x_mm, belt)
    holes = _compute_hole_sigma(weight * np.where(load.measured, 0.0, filled.sigma_mm), ~load.measured)
    # the narrow gaps between neighbouring points are holes too, with a smaller σ
    narrow = load.measured & filled.hole
    holes = np.hypot(holes, _compute_hole_sigma(weight * np.where(narrow, filled.sigma_mm, 0.0), narrow))
    edges = EDGE_PX * cell_mm * abs(_sum_step_area_mm2(filled, weights, cell_mm, factor))
    drift = belt.drift_mm * abs(float(weight.sum()))
    return VolumeSigma(float(noise), belt_sigma, float(holes), float(edges), float(drift))


def _compute_belt_sigma(
    weight: NDArray[np.float64], sigma_mm: NDArray[np.float64], x_mm: NDArray[np.float64], belt: Belt
) -> float:
    """Return σ of the belt's integral: fully correlated along each node of its section, independent across."""
    node = np.rint(np.interp(x_mm, belt.x_mm, np.arange(len(belt.x_mm)))).astype(np.intp)
    return float(np.sqrt(np.sum(np.bincount(node, (weight * sigma_mm).sum(axis=0)) ** 2)))


def _compute_hole_sigma(sigma_mm3: NDArray[np.float64], hole: NDArray[np.bool_]) -> float:
    """Return σ of a sum over holes: fully correlated within each block of a hole, with a share common to all."""
    label = np.zeros(hole.shape, np.int32)
    ndimage.label(hole, np.ones((3, 3)), output=label)
    rows, columns = int(hole.shape[0]), int(hole.shape[1])
    block = (np.arange(rows)[:, None] // _PATCH_CELLS) * (columns // _PATCH_CELLS + 1) + np.arange(columns)[
        None
    ] // _PATCH_CELLS
    own = np.unique(label[hole].astype(np.int64) * (block.max() + 1) + block[hole], return_inverse=True)[1]
    sums = np.bincount(own.ravel(), sigma_mm3[hole]) if hole.any() else np.zeros(1)
    return float(np.sqrt(np.sum(sums**2) * (1 - _COMMON_SHARE**2) + (_COMMON_SHARE * sums.sum()) ** 2))


def _sum_step_area_mm2(
    filled: Filled, weights: IntegrationWeights, cell_mm: float, factor: NDArray[np.float64] | None
) -> float:
    """Return the vertical area of the steps within the box, weighted by the factor."""
    own = np.ix_(weights.along > 0, weights.across > 0)
    inside = filled.value_mm[own]
    times = np.ones(inside.shape) if factor is None else factor[own]
    total = 0.0
    for axis in (0, 1):
        rise = np.abs(np.diff(inside, axis=axis))
        here = times[1:] if axis == 0 else times[:, 1:]
        total += float(np.sum(np.where(rise > STEP_SLOPE * cell_mm, rise * here, 0.0)))
    return cell_mm * total


_FALSE_SHARE = 0.5
"""Mean error of a load's measured part over that by which its doubtful depths would be too high if as many of them
were false as their confidence says: 0.06 to 0.8 on thirteen simulated heaps with both presets, 1.5 to 5 on two."""
_FALSE_REACH_MM = 15.0
"""A false depth beside a step is that of the other surface, which trusted depths show within this distance."""
_TRUSTED = 0.9
"""Confidence from which on a depth shows where the surface is."""


def compute_false_depths_mm3(
    loaded: DepthMap, camera: Camera, belt: Belt, box: Box, pixel_mm: float
) -> float:
    """Return σ of the volume from depths of the box that may be false (`compute_false_height_mm`)."""
    points = belt.belt_from_core.apply(loaded.points_mm(camera))
    across, along, up = np.moveaxis(points, -1, 0)
    inside = loaded.measured & (across >= box.across_mm[0]) & (across <= box.across_mm[1])
    inside &= (along >= box.along_mm[0]) & (along <= box.along_mm[1])
    area = (box.across_mm[1] - box.across_mm[0]) * (box.along_mm[1] - box.along_mm[0])
    height = up - belt.height_mm(across)
    return compute_false_height_mm(height, loaded.confidence, inside, pixel_mm) * area


def compute_false_height_mm(
    height_mm: NDArray[np.floating],
    confidence: NDArray[np.floating],
    used: NDArray[np.bool_],
    pixel_mm: float,
) -> float:
    """Return σ of the mean height of the used pixels from depths that may be false; 0 without any.

    ``height_mm``, ``confidence`` and ``used`` are (H, W), with pixels ``pixel_mm`` apart on the belt. A pixel of
    confidence p is false with the probability 1 - p; then the surface is likely the lower one nearby, for the matcher
    widens what is in front. The errors are alike over the whole belt: neither noise nor holes hold them.
    """
    if not used.any():
        return 0.0
    trusted = np.where(used & (confidence >= _TRUSTED), height_mm, np.inf).astype(np.float32)
    side = 2 * max(1, round(_FALSE_REACH_MM / pixel_mm)) + 1
    lowest = np.minimum(cv2.erode(trusted, np.ones((side, side), np.uint8)), height_mm)
    return _FALSE_SHARE * float(np.mean(((1 - confidence) * (height_mm - lowest))[used]))


_MIN_VIEW_SHARE = 0.5
"""Least share of the core's view that a belt is assumed to fill, where less of it was measured when empty."""
_MIN_WIDTH_SHARE = 0.5
"""A box chosen automatically covers this share of the belt's width, unless the frame is sparse: then the belt beside
it may be loaded like the box."""
_RIM_MM = 25.0
"""The load at a side of the box is the mean over this width, and what was measured shows in windows of this side: a
few lumps wide, narrow against the belt."""
_MIN_SEEN_SHARE = 0.5
"""Share of such a window that is measured where the load was seen; false depths beyond the light are scattered."""


def compute_extrapolated_mm3(load: Load, filled: Filled, weights: IntegrationWeights) -> float:
    """Return the volume of the cells outside what was measured: no measured cells bound them in row or column.

    So the box reaches beyond the view or the light. The load may go on there as high as the same part of the belt's
    width is on average, or as filled, or it may end.
    """
    side = max(3, round(_RIM_MM / load.grid.cell_mm))
    seen = ndimage.uniform_filter(load.measured.astype(np.float32), side, mode="nearest") >= _MIN_SEEN_SHARE
    bounded = np.zeros(seen.shape, np.bool_)
    for axis in (0, 1):
        before = np.maximum.accumulate(seen, axis=axis)
        after = np.flip(np.maximum.accumulate(np.flip(seen, axis), axis=axis), axis)
        bounded |= before & after
    on_average = np.abs(np.where(load.measured, filled.value_mm, 0.0).sum(axis=0)) / np.maximum(
        load.measured.sum(axis=0), 1
    )
    heights = np.where(bounded | load.measured, 0.0, np.maximum(np.abs(filled.value_mm), on_average))
    return float(weights.along @ heights @ weights.across)


def compute_beside_mm3(
    area_mm2: NDArray[np.float64], x_mm: NDArray[np.float64], box: Box, belt: Belt, camera: Camera
) -> float:
    """Return the volume beside a box narrower than the belt, were the load as high there as at the box's sides.

    ``area_mm2`` (Nx,) is the load's longitudinal section at each column ``x_mm``. A heap that rises out of the view
    ends at the view and not at the belt's edge: what it carries beyond shows in its height at the box's sides. Beside
    a box of a sparse frame the belt may be loaded like the box itself.
    """
    distance = float(belt.belt_from_core.inverse().translation_mm[2])
    view = distance * camera.size_px[0] / float(camera.focal_px[0])
    low, high = box.across_mm
    left, right = belt.across_mm
    width = max(right - left, _MIN_VIEW_SHARE * view)
    beyond = 0.5 * (width - (right - left))
    rim = min(_RIM_MM, 0.5 * (high - low))
    at_sides = 0.0
    for gap, inside in ((low - left, x_mm < low + rim), (right - high, x_mm > high - rim)):
        section = area_mm2[inside & (x_mm >= low) & (x_mm <= high)]
        at_sides += max(gap + beyond, 0.0) * abs(float(section.mean()))
    if high - low >= _MIN_WIDTH_SHARE * width:
        return at_sides
    within = abs(float(area_mm2[(x_mm >= low) & (x_mm <= high)].mean()))
    return max(at_sides, (width - (high - low)) * within)
