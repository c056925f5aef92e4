"""Point clouds with normals and colour, computed from depth maps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.cloud import PointCloud
from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.frames import Image
from beltscape.core.geometry.camera import Camera

_WINDOW_PX = 5
"""Side of the window in which the slopes are fitted."""
_STEP = 0.01
"""Relative difference of neighbouring depths beyond which they lie on different surfaces."""
_REACH_PX = _WINDOW_PX // 2 + 1
"""Number of rows above and below its own on which a normal depends."""


def compute_normals(
    depth_mm: NDArray[np.float32],
    rows: slice,
    rays: tuple[NDArray[np.float32], NDArray[np.float32]],
    focal_px: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Return (rows, W, 3) float32 unit normals towards the camera; NaN where the window determines no plane.

    With w = 1/Z a plane is linear in the pixel, w = a·x + b·y + c with rays (x, y, 1), and its normal is
    (a, b, c), so the gradient of w over the measured pixels of a window determines it without bias.

    Parameters
    ----------
    depth_mm
        (H, W) float32, NaN = not measured.
    rows
        Rows to compute, with start and stop.
    rays
        (W,) x/z of the columns and (H,) y/z of the rows.
    focal_px
        (2,) fx, fy.
    """
    around = slice(max(rows.start - _REACH_PX, 0), rows.stop + _REACH_PX)
    own = slice(rows.start - around.start, rows.stop - around.start)
    x, y = rays[0], rays[1][rows, None]
    fx, fy = focal_px.astype(np.float32)
    with np.errstate(invalid="ignore"):
        inverse = cast("NDArray[np.float32]", 1 / depth_mm[around])
        a = fx * _gradient(inverse, axis=1)[own]
        b = fy * _gradient(inverse, axis=0)[own]
        c = inverse[own] - a * x - b * y
        scale = -1 / np.sqrt(a * a + b * b + c * c)
    return np.asarray(cv2.merge([a * scale, b * scale, c * scale]), np.float32)


def _gradient(values: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Return the mean difference of neighbours on one surface within the window; NaN without any."""
    before = (slice(None), slice(-1)) if axis == 1 else (slice(-1), slice(None))
    step = np.zeros_like(values)
    usable = np.zeros(values.shape, np.bool_)
    step[before] = np.diff(values, axis=axis)
    usable[before] = np.abs(step[before]) < _STEP * values[before]
    step = np.where(usable, step, np.float32(0))
    window = (_WINDOW_PX - 1, _WINDOW_PX) if axis == 1 else (_WINDOW_PX, _WINDOW_PX - 1)
    # an even window of differences is centred on the pixel between the middle two
    anchor = (window[0] // 2, window[1] // 2)
    total = cv2.boxFilter(step, -1, window, anchor=anchor, normalize=False)
    count = cv2.boxFilter(usable.view(np.uint8), -1, window, anchor=anchor, normalize=False)
    return np.divide(total, count, out=np.full_like(values, np.nan), where=count > 0)


_WHITE_QUANTILE = 0.995
"""Quantile of the grey levels that is shown as white."""
_STRIP_PX = 1 << 16
"""Pixels that are processed at a time, so that intermediate arrays stay in the cache."""


class CloudBuilder:
    """Builder of point clouds for one camera, whose rays and distortion are computed once."""

    def __init__(self, camera: Camera) -> None:
        """Prepare rays and undistortion of the core camera."""
        self.camera = camera
        x, y = _ray_axes(camera)
        self._rays = x.astype(np.float32), y.astype(np.float32)
        self._distorted_px = np.empty((len(y), len(x), 2), np.float32)
        for rows in _split_rows(camera):
            ideal = np.stack(np.meshgrid(x, y[rows]), axis=-1)
            distorted = camera.distort(ideal) * camera.focal_px + camera.center_px
            self._distorted_px[rows] = np.nan_to_num(distorted, nan=-1e4)  # beyond the lens's domain: outside

    def undistort(self, image: Image) -> Image:
        """Return the image on the camera's pinhole grid; black outside the camera's view.

        Raises
        ------
        InputError
            When the image does not have the camera's size.
        """
        _require_size(image, "image", self.camera)
        border = cv2.BORDER_CONSTANT
        return np.asarray(cv2.remap(image, self._distorted_px, None, cv2.INTER_LINEAR, borderMode=border))

    def build(self, depth: DepthMap, image: Image | None) -> PointCloud:
        """Return the points of the measured pixels, row by row, in the core camera's frame (the paper's Eq. 25).

        Parameters
        ----------
        depth
            Depth (H, W) on the camera's undistorted pinhole grid.
        image
            Its distorted image, for the colour; with None the points are mid grey.

        Raises
        ------
        InputError
            When depth map or image do not have the camera's size.
        """
        _require_size(depth.depth_mm, "depth map", self.camera)
        measured = depth.measured
        count = int(np.count_nonzero(measured))
        points, normals = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
        end = 0
        for rows in _split_rows(self.camera):
            kept, z = measured[rows], depth.depth_mm[rows]
            start, end = end, end + int(np.count_nonzero(kept))
            strip_points = cv2.merge([z * self._rays[0], z * self._rays[1][rows, None], z])
            _copy_masked(points[start:end], np.asarray(strip_points, np.float32), kept)
            strip_normals = compute_normals(depth.depth_mm, rows, self._rays, self.camera.focal_px)
            _copy_masked(normals[start:end], strip_normals, kept)
        colors = self._sample_colors(image, measured, count)
        confidence = depth.confidence[measured]
        return PointCloud(points, normals, colors, depth.sigma_mm[measured], confidence=confidence)

    def _sample_colors(
        self, image: Image | None, measured: NDArray[np.bool_], count: int
    ) -> NDArray[np.uint8]:
        """Return (N, 3) uint8 RGB of the measured pixels, stretched so that the brightest parts are white."""
        if image is None:
            return np.full((count, 3), 128, np.uint8)
        undistorted = self.undistort(image)
        tones = _make_tone_curve(undistorted)
        colors = np.empty((count, 3), np.uint8)
        end = 0
        for rows in _split_rows(self.camera):
            kept, shown = measured[rows], tones.take(undistorted[rows])
            start, end = end, end + int(np.count_nonzero(kept))
            _copy_masked(
                colors[start:end], shown if shown.ndim == 3 else np.asarray(cv2.merge([shown] * 3)), kept
            )
        return colors


def cloud_from_depth(depth: DepthMap, camera: Camera, image: Image | None) -> PointCloud:
    """Return the point cloud of one frame, as `CloudBuilder.build` does; for many frames use the builder."""
    return CloudBuilder(camera).build(depth, image)


def undistort_image(image: Image, camera: Camera) -> Image:
    """Return one image undistorted, as `CloudBuilder.undistort` does."""
    return CloudBuilder(camera).undistort(image)


def _require_size(values: NDArray[np.generic], what: str, camera: Camera) -> None:
    """Raise InputError unless values (H, W, …) have the camera's size."""
    width, height = camera.size_px
    if values.shape[:2] != (height, width):
        raise InputError(
            f"the {what} is {values.shape[1]}×{values.shape[0]} px, but {camera.name} has {width}×{height}"
        )


def _split_rows(camera: Camera) -> Iterator[slice]:
    """Yield the camera's rows in strips."""
    width, height = camera.size_px
    step = max(_STRIP_PX // width, 1)
    for top in range(0, height, step):
        yield slice(top, min(top + step, height))


def _ray_axes(camera: Camera) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (W,) x/z of the columns and (H,) y/z of the rows of the pinhole grid."""
    (width, height), (fx, fy), (cx, cy) = camera.size_px, camera.focal_px, camera.center_px
    return (np.arange(width) - cx) / fx, (np.arange(height) - cy) / fy


def _copy_masked(points: NDArray[np.generic], values: NDArray[np.generic], kept: NDArray[np.bool_]) -> None:
    """Do ``points[:] = values[kept]`` for (h, w, 3) values; NumPy is much faster when a pixel is one item."""
    item = np.dtype((np.void, 3 * values.itemsize))
    points.view(item)[:, 0] = values.view(item)[..., 0][kept]


def _make_tone_curve(image: Image) -> NDArray[np.uint8]:
    """Return the (256,) or (65536,) uint8 levels to show, with the image's `_WHITE_QUANTILE` as white."""
    size = np.iinfo(image.dtype).max + 1
    counts = cv2.calcHist([image.reshape(len(image), -1)], [0], None, [size], [0, size]).ravel()
    # the quantile lies between two values
    rank = _WHITE_QUANTILE * (image.size - 1)
    first = int(rank)
    below, above = np.searchsorted(np.cumsum(counts, dtype=np.float64), (first, first + 1), "right")
    top = max(below + (rank - first) * (min(above, size - 1) - below), 1.0)
    return np.clip(np.arange(size, dtype=np.float32) * np.float32(255.0 / top), 0, 255).astype(np.uint8)
