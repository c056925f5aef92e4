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
from beltscape.stereo.pairwise.row_matching import match_rows

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
            quantise_root(cv2.remap(image, mapped, None, cv2.INTER_LINEAR))  # pyright: ignore[reportCallIssue, reportArgumentType]
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
