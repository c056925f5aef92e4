"""Tie points: textured points of the core image and their positions in the auxiliary images.

Guided matching searches around the positions that a depth map and the rig predict, unguided matching in small
rectified pairs over many rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Array
from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet, Image, to_grey
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.rig import Rig, scale_rig
from beltscape.kernels import load_on_processor
from beltscape.stereo.consistency.correlation import correlate_closely, correlate_widely, find_peaks
from beltscape.stereo.multiview.photometry import compute_texture_ratio, estimate_noise_variance
from beltscape.stereo.multiview.surface import compute_inverse_depth_scale, pack_projections
from beltscape.stereo.pairwise.rectification import RectifiedPair, quantise_root, rectify_pair

MAX_POINTS = 300
"""More points take longer and change the medians by less than the matching's own bias."""
_DETECTION_WIDTH_PX = 620
"""Corners are detected in an image of about this width: four times as fast as in one of 1224 px."""
_QUALITY = 0.01
"""Least corner strength as a share of the greatest (OpenCV's ``goodFeaturesToTrack``)."""
_TEXTURE = 6.0
"""Least variance of a patch over that of the noise; below it one match in five was wrong on dark belts."""
_TEXTURE_PX = 9
"""Side of the window in which the texture is compared with the noise."""


@dataclass(frozen=True, slots=True, eq=False)
class TiePoints:
    """Points of the core image and their correspondences."""

    core_px: Array
    """(N, 2) on the core's undistorted grid."""
    inverse_depth: Array
    """(N,) 1/mm at which the search began; the residuals do not depend on it."""
    observed_px: Mapping[str, Array]
    """By auxiliary: (N, 2) position in its distorted image; NaN: not found."""
    searched: Mapping[str, NDArray[np.bool_]]
    """By auxiliary: (N,) whether the point was searched in its image."""
    pixel_scale: float = 1.0
    """Pixel of the images in which the points were matched, in px of the rig's images."""
    _undistorted: dict[str, tuple[Camera, Array]] = field(
        default_factory=dict[str, tuple[Camera, Array]], init=False, repr=False
    )
    """By auxiliary: what `undistort` returned last, and for which camera."""

    def undistort(self, name: str, camera: Camera) -> Array:
        """Return (N, 2) undistorted coordinates of an auxiliary's positions, which fits ask for many times."""
        last = self._undistorted.get(name)
        if last is None or last[0] is not camera:
            last = self._undistorted[name] = camera, camera.undistort(self.observed_px[name])
        return last[1]


def join_tie_points(frames: Sequence[TiePoints]) -> TiePoints:
    """Return the tie points of several frames of one rig; a camera was not searched in a frame without it."""
    names = tuple(dict.fromkeys(name for each in frames for name in each.observed_px))

    def observed(each: TiePoints, name: str) -> Array:
        return each.observed_px.get(name, np.full(each.core_px.shape, np.nan))

    def searched(each: TiePoints, name: str) -> NDArray[np.bool_]:
        return each.searched.get(name, np.zeros(len(each.core_px), np.bool_))

    return TiePoints(
        np.concatenate([each.core_px for each in frames]),
        np.concatenate([each.inverse_depth for each in frames]),
        {name: np.concatenate([observed(each, name) for each in frames]) for name in names},
        {name: np.concatenate([searched(each, name) for each in frames]) for name in names},
        frames[0].pixel_scale,
    )


def detect_textured_points(image: Image, camera: Camera, *, max_points: int = MAX_POINTS) -> Array:
    """Return (N, 2) px on the core's undistorted grid: corners stronger than the noise, the strongest first."""
    level = to_grey(image) if image.dtype == np.uint8 else to_grey(image) / np.float32(257.0)
    shrink = max(1, round(level.shape[1] / _DETECTION_WIDTH_PX))
    size = (level.shape[1] // shrink, level.shape[0] // shrink)
    small = cv2.resize(level[: size[1] * shrink, : size[0] * shrink], size, interpolation=cv2.INTER_AREA)
    small = np.asarray(small, np.float32)
    texture = compute_texture_ratio(small, estimate_noise_variance(small), _TEXTURE_PX)
    distance = max(5.0, 0.5 * float(np.sqrt(size[0] * size[1] / max_points)))
    # the square root of the levels gives dark regions the same weight as bright ones
    root = np.sqrt(np.maximum(small, 0) + np.float32(1.0))
    mask = (texture >= _TEXTURE).astype(np.uint8)
    corners = cv2.goodFeaturesToTrack(root, 4 * max_points, _QUALITY, distance, mask=mask)
    if corners is None:
        return np.empty((0, 2))
    pixels = _select_evenly(corners[:, 0].astype(np.float64), size, max_points) * shrink + (shrink - 1) / 2
    undistorted = camera.undistort(pixels) * camera.focal_px + camera.center_px
    inside = ((undistorted >= 0) & (undistorted <= np.array(camera.size_px) - 1)).all(axis=1)
    return undistorted[inside]


def _select_evenly(corners: Array, size_px: tuple[int, int], max_points: int) -> Array:
    """Return at most ``max_points`` corners, with about the same number from each of the image's 8 × 6 cells."""
    cell = (corners / size_px * (8, 6)).astype(int)
    number = cell[:, 0] + 8 * cell[:, 1]
    order = np.argsort(number, kind="stable")
    start = np.searchsorted(number[order], number[order])
    rank = np.empty(len(corners), int)
    rank[order] = np.arange(len(corners)) - start
    return corners[np.argsort(rank, kind="stable")[:max_points]]


_HALF_PX = 7
"""Half the side of a patch."""
_SEARCH_RADII_PX = (4, 16, 40)
"""The search radius grows while too few points of a camera are found; 40 px is a turn of one or two degrees."""
_ENOUGH = 0.4
"""Share of a camera's points that must be found for the search to end."""
_CORRELATION = 0.7
"""Least normalised correlation of a match; 225 pixels of speckle reach 0.5 by chance."""
_SMOOTH = 0.02
"""Greatest mean deviation of a patch's inverse depth from its plane, as a share of it; a larger one means an edge."""
_MEASURED = 0.7
"""Least share of a patch with a depth."""
_HIDDEN_PX = 1.5
"""Disparity by which a nearer surface hides a pixel from an auxiliary: a belt's edge over a cover plate is 2 px."""
_HIDDEN = 0.1
"""Greatest share of a patch that an auxiliary does not see: what it sees there instead shifts the match towards it,
on one side of an edge in the same direction, as a movement of the camera would."""


def match_guided(
    frame_set: FrameSet, rig: Rig, auxiliaries: Sequence[str], depth: DepthMap, points_px: Array
) -> TiePoints:
    """Match points (N, 2) of the core's undistorted grid with each auxiliary image, starting from their depth."""
    centres = np.rint(points_px).astype(int)
    height, width = depth.depth_mm.shape
    inside = ((centres >= _HALF_PX) & (centres < np.array([width, height]) - _HALF_PX)).all(axis=1)
    centres = centres[inside]
    planes, is_smooth = _fit_planes(depth.depth_mm, centres)
    centres, planes = centres[is_smooth].astype(np.float64), planes[is_smooth]
    templates = _sample_patches(frame_set.images[rig.core], _distort_to_core(rig, centres, planes), _HALF_PX)
    observed: dict[str, Array] = {}
    searched: dict[str, NDArray[np.bool_]] = {}
    for name, is_seen in _find_seen_patches(rig, auxiliaries, depth, centres):
        observed[name], searched[name] = _search(
            frame_set.images[name], rig, name, centres, planes, templates, is_seen
        )
    return TiePoints(centres, planes[:, 0], observed, searched)


def _find_seen_patches(
    rig: Rig, auxiliaries: Sequence[str], depth: DepthMap, centres: Array
) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield every auxiliary with the mask (N,) of patches that no nearer surface of the depth map hides from it."""
    if not auxiliaries:
        return
    kernels, unit = load_on_processor(), compute_inverse_depth_scale(rig, auxiliaries)
    views = pack_projections(rig, tuple(auxiliaries), unit, 1)
    s = np.asarray(1 / (depth.depth_mm * np.float32(unit)), np.float32)
    buffers = kernels.inverse_depth_buffers(s, views, [rig.cameras[name].size_px for name in auxiliaries])
    column, row = centres.astype(np.int64).T
    for name, view, buffer in zip(auxiliaries, views, buffers, strict=True):
        hidden = depth.measured & (kernels.visible(s, view, buffer, _HIDDEN_PX) == 0)
        share = cv2.blur(hidden.astype(np.float32), (2 * _HALF_PX + 1, 2 * _HALF_PX + 1))
        yield name, np.asarray(share[row, column] <= _HIDDEN, np.bool_)


def _fit_planes(depth_mm: NDArray[np.float32], centres: NDArray[np.int64]) -> tuple[Array, NDArray[np.bool_]]:
    """Return (N, 3) inverse depth of patches with its slopes by u and v (1/mm, per px), and (N,) which are planar."""
    step = np.arange(-_HALF_PX, _HALF_PX + 1)
    window = depth_mm[
        centres[:, 1, None, None] + step[None, :, None], centres[:, 0, None, None] + step[None, None, :]
    ]
    window = window.reshape(len(centres), len(step) ** 2).astype(np.float64)
    measured = np.isfinite(window)
    inverse = np.where(measured, 1 / np.where(measured, window, 1.0), 0.0)
    u, v = (x.ravel().astype(np.float64) for x in np.meshgrid(step, step))
    basis = np.stack([np.ones_like(u), u, v], axis=1)
    weight = measured.astype(np.float64)
    normal = np.einsum("np,pi,pj->nij", weight, basis, basis) + 1e-9 * np.eye(3)
    right = np.einsum("np,pi->ni", inverse, basis)[..., None]
    planes = cast("NDArray[np.float64]", np.linalg.solve(normal, right))[..., 0]
    deviation = np.abs(inverse - planes @ basis.T) * weight
    scatter = deviation.sum(axis=1) / np.maximum(weight.sum(axis=1), 1)
    is_smooth = (weight.mean(axis=1) >= _MEASURED) & (scatter < _SMOOTH * np.abs(planes[:, 0]))
    return planes, is_smooth


def _search(
    image: Image,
    rig: Rig,
    name: str,
    centres: Array,
    planes: Array,
    templates: NDArray[np.float32],
    is_seen: NDArray[np.bool_],
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the positions of the templates in an auxiliary image (N, 2), and which were searched in it.

    Those are the patches that it sees, by the mask (N,), and whose prediction lies in the image.
    """
    predicted, slope = _project_to_auxiliary(rig, name, centres, planes)
    limit = np.array(image.shape[1::-1]) - _HALF_PX
    inside = np.all((predicted >= _HALF_PX) & (predicted < limit), axis=1) & is_seen
    observed = np.full(predicted.shape, np.nan)
    for radius in _SEARCH_RADII_PX:
        missing = np.flatnonzero(inside & np.isnan(observed[:, 0]))
        areas = _sample_patches(image, (predicted[missing], slope[missing]), _HALF_PX + radius)
        peaks = find_peaks(correlate_widely(zip(areas, templates[missing], strict=True)), _CORRELATION)
        observed[missing] = predicted[missing] + _apply_slopes(slope[missing], peaks - radius)
        if np.isfinite(observed[inside, 0]).sum() >= _ENOUGH * max(inside.sum(), 1):
            break
    for _ in range(_REFINEMENTS):
        _refine(image, observed, slope, templates)
    return observed, inside


_REFINEMENTS = 2
"""Times that a match is searched again about where it was found: a parabola through correlations has only 0.7 of a
shift of 0.1 px. In rendered frames whose camera turned by 0.12 px: 0.67 without, 0.85 with one, 0.91 with two."""
_REFINE_PX = 1
"""Radius of this search."""


def _refine(image: Image, observed: Array, slope: Array, templates: NDArray[np.float32]) -> None:
    """Move found positions (N, 2) in place to the peaks of correlation about them; one without a peak stays."""
    found = np.flatnonzero(np.isfinite(observed[:, 0]))
    areas = _sample_patches(image, (observed[found], slope[found]), _HALF_PX + _REFINE_PX)
    shift = find_peaks(correlate_closely(areas, templates[found]), _CORRELATION) - _REFINE_PX
    observed[found] += np.nan_to_num(_apply_slopes(slope[found], shift))


def _apply_slopes(slopes: Array, offsets: Array) -> Array:
    """Return the products (N, 2) of matrices (N, 2, 2) and offsets (N, 2)."""
    return slopes[:, :, 0] * offsets[:, :1] + slopes[:, :, 1] * offsets[:, 1:]


def _distort_to_core(rig: Rig, centres: Array, planes: Array) -> tuple[Array, Array]:
    """Return the pixels (N, 2) of the distorted core image at the centres, and derivatives (N, 2, 2) by u and v."""
    camera = rig.core_camera

    def project(points: Array, _: Array) -> Array:
        return (
            camera.distort((points - camera.center_px) / camera.focal_px) * camera.focal_px + camera.center_px
        )

    return _linearise(project, centres, planes)


def _project_to_auxiliary(rig: Rig, name: str, centres: Array, planes: Array) -> tuple[Array, Array]:
    """Return the pixels (N, 2) of an auxiliary image at the centres, on their planes, and derivatives (N, 2, 2)."""
    core, camera, pose = rig.core_camera, rig.cameras[name], rig.cam_from_core[name]

    def project(points: Array, inverse_depth: Array) -> Array:
        rays = np.concatenate([(points - core.center_px) / core.focal_px, np.ones((len(points), 1))], axis=1)
        return camera.project(pose.apply(rays / inverse_depth[:, None]))

    return _linearise(project, centres, planes)


def _linearise(
    project: Callable[[Array, Array], Array], centres: Array, planes: Array
) -> tuple[Array, Array]:
    """Return a projection's values at the centres and its central differences along the planes."""
    slope = np.empty((len(centres), 2, 2))
    for axis in (0, 1):
        step = np.zeros(2)
        step[axis] = _HALF_PX
        forth = project(centres + step, planes[:, 0] + _HALF_PX * planes[:, 1 + axis])
        back = project(centres - step, planes[:, 0] - _HALF_PX * planes[:, 1 + axis])
        slope[:, :, axis] = (forth - back) / (2 * _HALF_PX)
    return project(centres, planes[:, 0]), slope


def _sample_patches(image: Image, grid: tuple[Array, Array], half: int) -> NDArray[np.float32]:
    """Return (N, S, S) grey patches around centres (N, 2) with axes (N, 2, 2); the image's edges are repeated."""
    centres, axes = grid
    step = np.arange(-half, half + 1, dtype=np.float32)
    side = len(step)
    if not len(centres):
        return np.empty((0, side, side), np.float32)
    du, dv = (x.ravel() for x in np.meshgrid(step, step))
    offsets = axes.astype(np.float32) @ np.stack([du, dv])
    pixels = offsets + centres.astype(np.float32)[:, :, None]
    # OpenCV remaps images of at most 32767 rows and columns
    rows = [
        cv2.remap(image, part[:, 0], part[:, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for part in np.array_split(np.nan_to_num(pixels, nan=-1e4), max(1, -(-len(pixels) // 30000)))
    ]
    return to_grey(np.concatenate(rows)).reshape(-1, side, side)


_ROW_HALF_PX = 8
"""Half the side of a patch."""
_ROW_CORRELATION = 0.65
"""Least correlation of a match."""


def match_rows(
    core: NDArray[np.uint8],
    auxiliary: NDArray[np.uint8],
    corners: NDArray[np.int64],
    disparities: int,
    radius_rows: int,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return (N, 2) disparity and row offset, px, of points (N, 2) of the core, and the mask of searched ones.

    NaN where there is no match, or an ambiguous one.
    """
    matches, (column, row) = np.full((len(corners), 2), np.nan), corners.T
    reach_u, reach_v = _ROW_HALF_PX + disparities, _ROW_HALF_PX + radius_rows
    inside = (column >= reach_u) & (column + _ROW_HALF_PX < core.shape[1])
    inside &= (row >= reach_v) & (row + reach_v < core.shape[0])
    pairs = (
        (
            auxiliary[v - reach_v : v + reach_v + 1, u - reach_u : u + _ROW_HALF_PX + 1],
            core[v - _ROW_HALF_PX : v + _ROW_HALF_PX + 1, u - _ROW_HALF_PX : u + _ROW_HALF_PX + 1],
        )
        for u, v in corners[inside]
    )
    peaks = find_peaks(correlate_widely(pairs), _ROW_CORRELATION)
    matches[inside] = np.column_stack([disparities - peaks[:, 0], peaks[:, 1] - radius_rows])
    return matches, inside


_WIDTH_PX = 420
"""Width of the images that are searched; at a third of the size a wide search takes a thirtieth of the time."""
_SEARCH_ROWS = 24
"""Rows searched above and below: 3.5° of an ordinary lens."""


class UnguidedMatcher:
    """Matches points of a rig's frames anywhere in a depth range; each pair of cameras is rectified once."""

    def __init__(self, rig: Rig, depth_range_mm: tuple[float, float]) -> None:
        self._rig, self._depth_range_mm = rig, depth_range_mm
        self._factor = min(1.0, _WIDTH_PX / rig.core_camera.size_px[0])
        self._small = scale_rig(rig, self._factor)
        self._pairs: dict[str, RectifiedPair | None] = {}

    def match(self, frame_set: FrameSet, auxiliaries: Sequence[str], points_px: Array) -> TiePoints:
        """Match points (N, 2) of the core's undistorted grid with each auxiliary image."""
        core = _shrink(frame_set.images[self._rig.core], self._small.core_camera.size_px)
        observed: dict[str, Array] = {}
        searched: dict[str, NDArray[np.bool_]] = {}
        for name in auxiliaries:
            auxiliary = _shrink(frame_set.images[name], self._small.cameras[name].size_px)
            observed[name], searched[name] = self._search(name, core, auxiliary, points_px)
        near_mm, far_mm = self._depth_range_mm
        middle = np.full(len(points_px), 0.5 / near_mm + 0.5 / far_mm)
        return TiePoints(points_px, middle, observed, searched, 1 / self._factor)

    def _search(
        self, name: str, core: Image, auxiliary: Image, points_px: Array
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Return the positions of the points in the auxiliary's full image (N, 2), and which were searched."""
        pair = self._rectify(name) if len(points_px) else None
        if pair is None:
            return np.full(points_px.shape, np.nan), np.zeros(len(points_px), np.bool_)
        camera = self._rig.core_camera
        rectified_px, _ = pair.project_core_rays((points_px - camera.center_px) / camera.focal_px)
        corners = np.rint(rectified_px).astype(np.int64)
        left, right = (
            quantise_root(cv2.remap(image, mapped, None, cv2.INTER_LINEAR))
            for image, mapped in ((core, pair.core_map), (auxiliary, pair.aux_map))
        )
        matches, inside = match_rows(left, right, corners, pair.disparities, _SEARCH_ROWS)
        # the match of the rounded position, shifted by the rounding
        matched_px = rectified_px + np.stack([-matches[:, 0], matches[:, 1]], axis=1)
        source = _map_to_auxiliary(pair, matched_px)
        factor = np.array(self._small.cameras[name].size_px) / np.array(self._rig.cameras[name].size_px)
        return (source + 0.5) / factor - 0.5, inside

    def _rectify(self, name: str) -> RectifiedPair | None:
        """Return the small pair of the core and an auxiliary; None without a common view, or if it is too large."""
        if name not in self._pairs:
            try:
                pair = rectify_pair(self._small, name, self._depth_range_mm)
            except ReconstructionError:
                pair = None
            self._pairs[name] = None if pair is None or max(pair.size_px) > 4 * _WIDTH_PX else pair
        return self._pairs[name]


@lru_cache(maxsize=2)
def make_unguided_matcher(rig: Rig, depth_range_mm: tuple[float, float]) -> UnguidedMatcher:
    """Return the rig's matcher; all checks of a sequence rectify each of its pairs once."""
    return UnguidedMatcher(rig, depth_range_mm)


def _map_to_auxiliary(pair: RectifiedPair, rectified_px: Array) -> Array:
    """Return the pixels (N, 2) of the auxiliary's image for pixels (N, 2) of its rectified view; NaN outside."""
    width, height = pair.size_px
    good = np.asarray(np.isfinite(rectified_px).all(axis=1))
    good[good] = ((rectified_px[good] >= 0) & (rectified_px[good] <= np.array([width, height]) - 1)).all(
        axis=1
    )
    inside_px = np.where(good[:, None], rectified_px, 0).astype(np.float32)
    source = cv2.remap(pair.aux_map, inside_px[None, :, 0], inside_px[None, :, 1], cv2.INTER_LINEAR)[0]
    source = np.asarray(source, np.float64)
    good &= (source > -0.5).all(axis=1)
    source[~good] = np.nan
    return source


def _shrink(image: Image, size_px: tuple[int, int]) -> Image:
    if image.shape[1::-1] == tuple(size_px):
        return image
    return cv2.resize(image, size_px, interpolation=cv2.INTER_AREA)
