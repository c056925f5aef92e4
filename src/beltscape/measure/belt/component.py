"""The pixels of an empty belt's depth map that may show the belt: one continuous surface under the optical axis."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.errors import MeasureError
from beltscape.core.geometry.camera import Camera
from beltscape.measure.belt.blocks import BlockPlanes

_LEAST_BLOCKS = 30
"""A surface of fewer blocks does not determine a frame; then all blocks are taken, as `find_initial_frame` does."""
_UNEVEN_SHARE = 0.1
"""A block scatters more than this share of its side about its plane, beside the noise, where it holds a step: a fold
of 45° in its middle scatters by 0.07, a step of a third of the side by 0.16."""
_STEP_SHARE, _NOISES = 0.12, 4.0
"""Two planes are one surface where they miss each other by less than this share of the blocks' distance and this
multiple of the usual scatter: 5 mm for blocks 40 mm apart. A block with a fold misses its neighbours by 3 mm."""
_CONCAVE, _CONVEX = float(np.cos(np.deg2rad(75.0))), float(np.cos(np.deg2rad(12.0)))
"""A trough folds upwards, at most by this angle from block to block (two rolls at 35°; a board stands at 90° on a
flat belt); what bends down from the belt is something else (a wing beside a level rail: 20° and more)."""
_BRIDGED = 3
"""Blocks that were not measured are bridged up to this number: a tenth of the image's width."""


def mask_region(depth: DepthMap, region_px: Sequence[tuple[float, float]]) -> DepthMap:
    """Return the depth map within a polygon (u, v) of the undistorted image; elsewhere it counts as not measured.

    Raises
    ------
    MeasureError
        if next to nothing was measured in the polygon.
    """
    inside = np.zeros(depth.depth_mm.shape, np.uint8)
    corners = np.rint(np.array(region_px, np.float64) * 16).astype(np.int32)
    cv2.fillPoly(inside, [corners], 1, shift=4)
    masked = keep_pixels(depth, inside > 0)
    if masked.measured.sum() < 1000:
        low, high = (np.array(region_px).min(axis=0), np.array(region_px).max(axis=0))
        raise MeasureError(
            f"empty belt: hardly anything was measured in the region u {low[0]:g} to {high[0]:g}, v {low[1]:g} to "
            f"{high[1]:g} px; the image has {depth.depth_mm.shape[1]}×{depth.depth_mm.shape[0]} px: draw the region "
            "around the belt"
        )
    return masked


def keep_pixels(depth: DepthMap, keep: NDArray[np.bool_]) -> DepthMap:
    """Return the depth map with the other pixels not measured."""
    return DepthMap(
        np.where(keep, depth.depth_mm, np.float32(np.nan)),
        np.where(keep, depth.sigma_mm, np.float32(np.nan)),
        np.where(keep, depth.views, 0).astype(depth.views.dtype),
        np.where(keep, depth.confidence, 0).astype(depth.confidence.dtype),
    )


def find_component(
    planes: BlockPlanes, camera: Camera, side_px: int, *, largest: bool = False
) -> NDArray[np.bool_]:
    """Return which blocks (M,) belong to the surface that the optical axis meets, or to the ``largest`` one.

    Neighbouring blocks are one surface where their planes meet, or fold upwards between them. A step to a floor, a
    frame or a board separates them, whatever its area. All blocks are returned where the surface is too small.
    """
    if len(planes.rms_mm) < _LEAST_BLOCKS:
        return np.ones(len(planes.rms_mm), bool)
    block_mm = side_px * planes.centers_mm[:, 2] / float(camera.focal_px.mean())
    usual = float(np.median(planes.rms_mm))
    even = planes.rms_mm <= 3 * usual + _UNEVEN_SHARE * block_mm
    label = _label_components(_link_blocks(planes, even, usual), len(even))
    count = np.bincount(label[even], minlength=len(even))
    big = even & (count[label] >= _LEAST_BLOCKS)
    if not big.any():
        return np.ones(len(even), bool)
    if largest:
        return even & (label == int(np.argmax(count)))
    ray = planes.centers_mm[:, :2] / planes.centers_mm[:, 2:]
    off_axis = np.where(big, np.linalg.norm(ray, axis=1), np.inf)
    return even & (label == label[int(np.argmin(off_axis))])


def select_pixels(depth: DepthMap, camera: Camera, planes: BlockPlanes, side_px: int) -> NDArray[np.bool_]:
    """Return the pixels (H, W) of the blocks that lie near their block's plane."""
    shape = depth.depth_mm.shape
    blocks = np.full((3, shape[0] // side_px + 1, shape[1] // side_px + 1), np.nan)
    # the plane n · p = d meets the ray (x, y, 1) at the depth d / (n · (x, y, 1))
    distance = np.sum(planes.normals * planes.centers_mm, axis=1)
    blocks[:, planes.row, planes.column] = (planes.normals / distance[:, None]).T
    x, y, one = (np.kron(part, np.ones((side_px, side_px)))[: shape[0], : shape[1]] for part in blocks)
    rays = camera.rays()
    inverse = x * rays[..., 0] + y * rays[..., 1] + one
    usual = float(np.median(planes.rms_mm))
    near = _NOISES * usual + _UNEVEN_SHARE * side_px * depth.depth_mm / float(camera.focal_px.mean())
    with np.errstate(divide="ignore"):
        return np.abs(depth.depth_mm - 1 / inverse) <= near  # NaN is not


def _label_components(pairs: NDArray[np.intp], number: int) -> NDArray[np.intp]:
    """Return the smallest member (M,) of the component that each of ``number`` blocks belongs to by linked pairs."""
    label = np.arange(number)
    while True:
        lower = label[pairs].min(axis=1)
        joined = label.copy()
        np.minimum.at(joined, pairs.ravel(), np.repeat(lower, 2))
        joined = joined[joined]
        if np.array_equal(joined, label):
            return label
        label = joined


def _link_blocks(planes: BlockPlanes, even: NDArray[np.bool_], usual_mm: float) -> NDArray[np.intp]:
    """Return pairs (N, 2) of blocks of one surface, next to each other or across blocks that were not measured."""
    shape = (int(planes.row.max()) + 1, int(planes.column.max()) + 1)
    number = np.full(shape, -1, np.intp)
    number[planes.row, planes.column] = np.arange(len(even))
    found: list[NDArray[np.intp]] = []
    for grid in (number, number.T):
        for apart in range(1, _BRIDGED + 2):
            first, second = grid[:-apart], grid[apart:]
            linked = (first >= 0) & (second >= 0)
            for between in range(1, apart):
                linked &= grid[between : between - apart] < 0
            pair = np.stack([first[linked], second[linked]], axis=1)
            pair = pair[even[pair].all(axis=1)]
            found.append(pair[_is_one_surface(planes, pair, usual_mm)])
    return np.concatenate(found)


def _is_one_surface(planes: BlockPlanes, pair: NDArray[np.intp], usual_mm: float) -> NDArray[np.bool_]:
    """Return which pairs (N, 2) of planes meet between their blocks, flat or folded upwards."""
    one, two = pair.T
    way = planes.centers_mm[two] - planes.centers_mm[one]
    rise_two = np.sum(way * planes.normals[one], axis=1)
    rise_one = -np.sum(way * planes.normals[two], axis=1)
    # planes that meet between the blocks lie both above, or both below each other's centres
    step = np.where(rise_one * rise_two >= 0, 0.0, np.minimum(np.abs(rise_one), np.abs(rise_two)))
    turn = np.sum(planes.normals[one] * planes.normals[two], axis=1)
    limit = np.where(rise_one + rise_two >= 0, _CONCAVE, _CONVEX)
    return (step <= _STEP_SHARE * np.linalg.norm(way, axis=1) + _NOISES * usual_mm) & (turn >= limit)
