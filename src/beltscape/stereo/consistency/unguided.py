"""Tie points found without a depth map, in small rectified pairs with a wide range of rows."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet, Image
from beltscape.core.rig import Rig
from beltscape.core.scaling import scale_rig
from beltscape.stereo.consistency.tie_points import Array, TiePoints
from beltscape.stereo.pairwise.contrast import quantise_root
from beltscape.stereo.pairwise.rectification import RectifiedPair, rectify_pair
from beltscape.stereo.pairwise.row_error import match_rows

_WIDTH_PX = 420
"""Width of the images searched: at a third of the size a wide search costs a thirtieth."""
_REACH_ROWS = 24
"""Rows searched above and below: 3.5° of an ordinary lens."""


def unguided_points(
    frame_set: FrameSet,
    rig: Rig,
    auxiliaries: Sequence[str],
    depth_range_mm: tuple[float, float],
    points_px: Array,
) -> TiePoints:
    """Find points (N, 2) of the core's undistorted grid in each auxiliary image, anywhere in the depth range."""
    factor = min(1.0, _WIDTH_PX / rig.core_camera.size_px[0])
    small = scale_rig(rig, factor)
    core = _shrunk(frame_set.images[rig.core], small.core_camera.size_px)
    found, searched = {}, {}
    for name in auxiliaries:
        auxiliary = _shrunk(frame_set.images[name], small.cameras[name].size_px)
        found[name], searched[name] = _search(small, name, core, auxiliary, depth_range_mm, points_px, rig)
    middle = 0.5 / depth_range_mm[0] + 0.5 / depth_range_mm[1]
    return TiePoints(points_px, np.full(len(points_px), middle), found, searched, 1 / factor)


def _search(
    small: Rig,
    name: str,
    core: Image,
    auxiliary: Image,
    depth_range_mm: tuple[float, float],
    points_px: Array,
    rig: Rig,
) -> tuple[Array, NDArray[np.bool_]]:
    """Where the auxiliary's full image shows the points (N, 2), and which were searched."""
    nothing = np.full(points_px.shape, np.nan), np.zeros(len(points_px), np.bool_)
    try:
        pair = rectify_pair(small, name, depth_range_mm)
    except ReconstructionError:
        return nothing
    if max(pair.size_px) > 4 * _WIDTH_PX:
        return nothing
    rays = (points_px - rig.core_camera.center_px) / rig.core_camera.focal_px
    places, _ = pair.core_pixels(rays)
    corners = np.rint(places).astype(np.int64)
    left, right = (
        quantise_root(cv2.remap(image, mapped, None, cv2.INTER_LINEAR))  # pyright: ignore[reportCallIssue, reportArgumentType]
        for image, mapped in ((core, pair.core_map), (auxiliary, pair.aux_map))
    )
    matches, inside = match_rows(left, right, corners, pair.disparities, _REACH_ROWS)
    # the correspondence of the rounded place, moved by what was rounded off
    at = places + np.stack([-matches[:, 0], matches[:, 1]], axis=1)
    source = _looked_up(pair, at)
    factor = np.array(small.cameras[name].size_px) / np.array(rig.cameras[name].size_px)
    return (source + 0.5) / factor - 0.5, inside


def _looked_up(pair: RectifiedPair, at: Array) -> Array:
    """Pixels (N, 2) of the auxiliary's image at places (N, 2) of the rectified view; NaN outside."""
    width, height = pair.size_px
    good = np.asarray(np.isfinite(at).all(axis=1))
    good[good] = ((at[good] >= 0) & (at[good] <= np.array([width, height]) - 1)).all(axis=1)
    where = np.where(good[:, None], at, 0).astype(np.float32)
    source = cv2.remap(pair.aux_map, where[None, :, 0], where[None, :, 1], cv2.INTER_LINEAR)[0]
    source = np.asarray(source, np.float64)
    good &= (source > -0.5).all(axis=1)
    source[~good] = np.nan
    return source


def _shrunk(image: Image, size_px: tuple[int, int]) -> Image:
    if image.shape[1::-1] == tuple(size_px):
        return image
    return cv2.resize(image, size_px, interpolation=cv2.INTER_AREA)  # pyright: ignore[reportReturnType]
