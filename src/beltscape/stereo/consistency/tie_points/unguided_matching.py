"""Unguided matching of tie points: a search in small rectified pairs over many rows, without a depth map."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet, Image
from beltscape.core.geometry.rig import Rig
from beltscape.core.geometry.scaling import scale_rig
from beltscape.stereo.consistency.tie_points.tie_points import Array, TiePoints
from beltscape.stereo.pairwise.contrast import quantise_root
from beltscape.stereo.pairwise.rectification import RectifiedPair, rectify_pair
from beltscape.stereo.pairwise.row_error import match_rows

_WIDTH_PX = 420
"""Width of the images that are searched; at a third of the size a wide search takes a thirtieth of the time."""
_SEARCH_ROWS = 24
"""Rows searched above and below: 3.5° of an ordinary lens."""


def match_unguided(
    frame_set: FrameSet,
    rig: Rig,
    auxiliaries: Sequence[str],
    depth_range_mm: tuple[float, float],
    points_px: Array,
) -> TiePoints:
    """Match points (N, 2) of the core's undistorted grid with each auxiliary image, anywhere in the depth range."""
    factor = min(1.0, _WIDTH_PX / rig.core_camera.size_px[0])
    small = scale_rig(rig, factor)
    core = _shrink(frame_set.images[rig.core], small.core_camera.size_px)
    observed: dict[str, Array] = {}
    searched: dict[str, NDArray[np.bool_]] = {}
    for name in auxiliaries:
        auxiliary = _shrink(frame_set.images[name], small.cameras[name].size_px)
        observed[name], searched[name] = _search(small, name, core, auxiliary, depth_range_mm, points_px, rig)
    middle = 0.5 / depth_range_mm[0] + 0.5 / depth_range_mm[1]
    return TiePoints(points_px, np.full(len(points_px), middle), observed, searched, 1 / factor)


def _search(
    small: Rig,
    name: str,
    core: Image,
    auxiliary: Image,
    depth_range_mm: tuple[float, float],
    points_px: Array,
    rig: Rig,
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the positions of the points in the auxiliary's full image (N, 2), and which were searched."""
    nothing = np.full(points_px.shape, np.nan), np.zeros(len(points_px), np.bool_)
    if not len(points_px):
        return nothing
    try:
        pair = rectify_pair(small, name, depth_range_mm)
    except ReconstructionError:
        return nothing
    if max(pair.size_px) > 4 * _WIDTH_PX:
        return nothing
    rays = (points_px - rig.core_camera.center_px) / rig.core_camera.focal_px
    rectified_px, _ = pair.project_core_rays(rays)
    corners = np.rint(rectified_px).astype(np.int64)
    left, right = (
        quantise_root(cv2.remap(image, mapped, None, cv2.INTER_LINEAR))  # pyright: ignore[reportCallIssue, reportArgumentType]
        for image, mapped in ((core, pair.core_map), (auxiliary, pair.aux_map))
    )
    matches, inside = match_rows(left, right, corners, pair.disparities, _SEARCH_ROWS)
    # the match of the rounded position, shifted by the rounding
    matched_px = rectified_px + np.stack([-matches[:, 0], matches[:, 1]], axis=1)
    source = _map_to_auxiliary(pair, matched_px)
    factor = np.array(small.cameras[name].size_px) / np.array(rig.cameras[name].size_px)
    return (source + 0.5) / factor - 0.5, inside


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
    return cv2.resize(image, size_px, interpolation=cv2.INTER_AREA)  # pyright: ignore[reportReturnType]
