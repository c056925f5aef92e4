"""The extent of the belt across: its ends against floor, gap, frame or board, along the core camera's rays.

Only one continuous surface under the optical axis may show the belt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.empty_belt import End
from beltscape.core.errors import MeasureError
from beltscape.core.geometry.camera import Camera
from beltscape.measure.belt.cross_section import STEP_MM, BeltCrossSection
from beltscape.measure.belt.initial_frame import BlockPlanes

_BINS = 160
"""Bins over the width of the surface, as the nodes of the cross-section."""
_PROLONG_SHARE, _PROLONG_MM, _RIM_NODES = 0.1, 60.0, 3
"""The section is prolonged by the line through its outermost stretch of this share of its width, and at least this,
but for the nodes at its rim, which points of two surfaces may share."""
_NOISES = 6.0
"""A point lies on the belt within this multiple of the scatter, and a pixel: 1 of 5·10⁸ of its points lies off."""
_ON_SHARE, _LEAST_DENSITY = 0.35, 0.2
"""A bin shows the belt where this share of its points lies on it (the rest may be beams, dirt, mismatches), and this
share of the usual density was measured: a few wrong points beyond the end are no belt."""
_GAP_SHARE, _SHADOW_SHARE = 0.1, 0.25
"""A strip without measured points, such as a shadow or a wet strip, is bridged up to the first share of the width.
What is beside the belt is measured within the second: the belt hides a strip of the floor from auxiliaries."""
_MARGIN_SHARE = 0.5
"""Rays that meet the prolonged section further beyond its ends than this share of its width are left out."""
_BESIDE, _DENSE = 3, 0.5
"""Bins beyond an end that show what is beside it; these are measured at this share of the belt's density."""
_SURE = 0.5
"""Pixels of a lower confidence count as not measured: they lie between two surfaces."""


@dataclass(frozen=True, slots=True, eq=False)
class BeltExtent:
    """The belt's ends in the frame of its cross-section, and the pixels between them."""

    across_mm: tuple[float, float]
    """Ends in x."""
    ends: tuple[End, End]
    """What is known of the end at the smaller and at the larger x."""
    clear_mm: tuple[float, float]
    """Range of x that is clear of things beside the belt that stand as high as it; -inf, inf without one."""
    even_share: float
    """Share of the measured pixels between the ends that lie on the belt."""


@dataclass(frozen=True, slots=True, eq=False)
class _Bins:
    """Counts of pixels (K,) by the position where their rays meet the prolonged belt, from the smallest x on."""

    edges_mm: NDArray[np.float64]
    """(K + 1,) borders of the bins."""
    expected: NDArray[np.intp]
    """Pixels whose rays meet the belt there, measured or not."""
    on: NDArray[np.intp]
    """Pixels that show it."""
    below: NDArray[np.intp]
    """Pixels that show something below it."""
    above: NDArray[np.intp]
    """Pixels that show something above it."""

    def reversed(self) -> _Bins:
        """Return the bins mirrored, so that the left end is found as the right one."""
        parts = (self.expected, self.on, self.below, self.above)
        return _Bins(-self.edges_mm[::-1], *(part[::-1] for part in parts))

    @property
    def measured(self) -> NDArray[np.intp]:
        """Return the number of measured pixels."""
        return self.on + self.below + self.above


def find_extent(depth: DepthMap, camera: Camera, section: BeltCrossSection, stride: int) -> BeltExtent:
    """Find the ends of the belt whose ``section`` was fitted to a part of its surface.

    Every ray is intersected with the section, prolonged beyond its ends; its pixel shows the belt, or something
    below or above it. From the middle outwards the belt ends where most pixels show something else, where the image
    ends, or where nothing more was measured. In the image a floor far below begins beside the belt's end, whatever
    its distance in x.
    """
    x, off, measured = _intersect(depth, camera, section, stride)
    pixel_mm = stride * float(np.nanmedian(depth.depth_mm)) / float(camera.focal_px.mean())
    bins = _count(x, off, measured, section, pixel_mm)
    density = _usual_density(bins, section)
    start = _find_start(bins, section, density)
    width_mm = float(np.ptp(section.x_mm[np.isfinite(section.z_mm)]))
    right, right_end, right_clear = _walk(bins, start, density, width_mm)
    left, left_end, left_clear = _walk(bins.reversed(), len(bins.on) - 1 - start, density, width_mm)
    inside = (bins.edges_mm[:-1] > -left - 1e-6) & (bins.edges_mm[1:] < right + 1e-6)
    share = float(bins.on[inside].sum() / max(int(bins.measured[inside].sum()), 1))
    return BeltExtent((-left, right), (left_end, right_end), (-left_clear, right_clear), share)


def on_belt_mask(
    points_mm: NDArray[np.float64], section: BeltCrossSection, across_mm: tuple[float, float]
) -> NDArray[np.bool_]:
    """Return which points (N, 3) in the camera's frame lie between the ends and near the section."""
    x, _, z = np.einsum("ij,nj->in", section.rotation, points_mm)
    near = np.abs(z - prolong(section, x)) <= max(_NOISES * section.noise_mm, STEP_MM)
    return near & (x >= across_mm[0]) & (x <= across_mm[1])


def prolong(section: BeltCrossSection, x_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the height of the section at x, prolonged linearly beyond its ends."""
    measured = np.isfinite(section.z_mm)
    nodes, heights = section.x_mm[measured], section.z_mm[measured]
    reach = max(_PROLONG_SHARE * float(np.ptp(nodes)), _PROLONG_MM)
    z = np.interp(x_mm, nodes, heights)
    for inner, sign in ((nodes[_RIM_NODES], -1.0), (nodes[-1 - _RIM_NODES], 1.0)):
        own = (sign * (nodes - inner) <= 0) & (sign * (nodes - inner) >= -reach)
        line = np.asarray(np.polyfit(nodes[own] - inner, heights[own], 1), np.float64)
        slope, at = float(line[0]), float(line[1])
        z = np.where(sign * (x_mm - inner) > 0, at + slope * (x_mm - inner), z)
    return z


def _intersect(
    depth: DepthMap, camera: Camera, section: BeltCrossSection, stride: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Return x (N,) where rays meet the prolonged section, each pixel's height off it, and whether it is measured."""
    part = slice(None, None, stride)
    z = depth.depth_mm[part, part].astype(np.float64).ravel()
    rays = camera.rays(part).reshape(-1, 2)
    across, _, up = np.einsum("ij,nj->in", section.rotation, np.column_stack([rays, np.ones(len(rays))]))
    known = section.x_mm[np.isfinite(section.z_mm)]
    margin = _MARGIN_SHARE * float(np.ptp(known))
    low, high = float(known[0]) - margin, float(known[-1]) + margin
    reach = np.full(len(z), float(np.nanmedian(z)))
    for _ in range(25):  # halved steps converge where a wing is steeper than the ray, too
        reach = 0.5 * (reach + prolong(section, np.clip(reach * across, low, high)) / up)
    x = reach * across
    near = (x > low) & (x < high)
    measured = np.isfinite(z) & (depth.confidence[part, part].ravel() >= _SURE)
    return x[near], ((z - reach) * up)[near], measured[near]


def _count(
    x: NDArray[np.float64],
    off: NDArray[np.float64],
    measured: NDArray[np.bool_],
    section: BeltCrossSection,
    pixel_mm: float,
) -> _Bins:
    """Return the counts in bins of two pixels or more over the image."""
    known = section.x_mm[np.isfinite(section.z_mm)]
    width = max(float(known[-1] - known[0]) / _BINS, 2 * pixel_mm)
    low, high = float(x.min()), float(x.max())
    number = max(8, int((high - low) / width) + 1)
    edges = low + width * np.arange(number + 1, dtype=np.float64)
    own = np.clip(((x - low) / width).astype(np.intp), 0, number - 1)
    tolerance = _NOISES * section.noise_mm + pixel_mm

    def count(flags: NDArray[np.bool_]) -> NDArray[np.intp]:
        return np.bincount(own[flags], minlength=number)

    everywhere = np.ones(len(x), bool)
    return _Bins(
        edges,
        count(everywhere),
        count(measured & (np.abs(off) <= tolerance)),
        count(measured & (off < -tolerance)),
        count(measured & (off > tolerance)),
    )


def _usual_density(bins: _Bins, section: BeltCrossSection) -> float:
    """Return the share of pixels that show the belt in the middle half of the section."""
    known = section.x_mm[np.isfinite(section.z_mm)]
    quarter = 0.25 * float(known[-1] - known[0])
    inner = (bins.edges_mm[:-1] >= known[0] + quarter) & (bins.edges_mm[1:] <= known[-1] - quarter)
    share = bins.on[inner] / np.maximum(bins.expected[inner], 1)
    return float(np.median(share)) if len(share) else 0.0


def _find_start(bins: _Bins, section: BeltCrossSection, density: float) -> int:
    """Return the bin that shows the belt nearest to the middle of the section."""
    known = section.x_mm[np.isfinite(section.z_mm)]
    middle = 0.5 * (bins.edges_mm[:-1] + bins.edges_mm[1:]) - float(np.median(known))
    return int(np.argmin(np.where(_on_mask(bins, density), np.abs(middle), np.inf)))


def _on_mask(bins: _Bins, density: float) -> NDArray[np.bool_]:
    """Return which bins (K,) show the belt."""
    dense = bins.on >= np.maximum(_LEAST_DENSITY * density * bins.expected, 3)
    return dense & (bins.on >= _ON_SHARE * bins.measured)


def _walk(bins: _Bins, start: int, density: float, width_mm: float) -> tuple[float, End, float]:
    """Return the belt's end at the larger x, what is known of it, and where something as high begins beyond it."""
    on = _on_mask(bins, density)
    is_seen = bins.measured >= np.maximum(_LEAST_DENSITY * density * bins.expected, 3)
    last = start
    while True:
        beyond = np.flatnonzero(on[last + 1 :] | is_seen[last + 1 :])
        if not len(beyond):
            break
        following = last + 1 + int(beyond[0])
        if not on[following] or bins.edges_mm[following] - bins.edges_mm[last + 1] > _GAP_SHARE * width_mm:
            break
        last = following
    end = float(bins.edges_mm[last + 1])
    outside = np.arange(last + 1, len(on))
    dense = outside[(bins.measured >= np.maximum(_DENSE * density * bins.expected, 3))[outside]]
    standing = dense[(bins.on + bins.above)[dense] > bins.below[dense]]
    clear = float(bins.edges_mm[standing[0]]) if len(standing) else np.inf
    beside = dense[bins.edges_mm[dense] - end <= _SHADOW_SHARE * width_mm][:_BESIDE]
    return end, _classify(bins, last, beside), clear


def _classify(bins: _Bins, last: int, beside: NDArray[np.intp]) -> End:
    """Return what is known of an end behind bin ``last`` from the bins ``beside`` it."""
    usual = float(np.median(bins.expected[bins.on > 0]))
    if bins.expected[last + 1 :][:_BESIDE].sum() < 0.1 * usual * _BESIDE:
        return "out of view"
    if not len(beside):
        return "unmeasured"
    return "seen" if bins.below[beside].sum() >= bins.above[beside].sum() else "covered"


_LEAST_BLOCKS = 30
"""A surface of fewer blocks does not determine a frame; then all blocks are taken, as `find_initial_frame` does."""
_UNEVEN_SHARE = 0.1
"""A block scatters more than this share of its side about its plane, beside the noise, where it holds a step: a fold
of 45° in its middle scatters by 0.07, a step of a third of the side by 0.16."""
_STEP_SHARE, _CONTINUOUS_NOISES = 0.12, 4.0
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
    near = _CONTINUOUS_NOISES * usual + _UNEVEN_SHARE * side_px * depth.depth_mm / float(
        camera.focal_px.mean()
    )
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
    return (step <= _STEP_SHARE * np.linalg.norm(way, axis=1) + _CONTINUOUS_NOISES * usual_mm) & (
        turn >= limit
    )
