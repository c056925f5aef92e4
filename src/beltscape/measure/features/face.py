"""A flat upper face: a weighted plane fitted to its interior, with its covariance under correlated errors.

The correlation area of the errors follows from the autocorrelation of residuals on faces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from beltscape.core.statistics import MAD_TO_SIGMA, compute_biweights
from beltscape.measure.features.smoothing import MATCHER_REACH_PX, compute_camera_scale

_MIN_PIXELS = 30
"""Least number of pixels of a plane."""
_OFF_MM = 3.0
"""Pixels farther than this from the nominal module's face do not belong to it."""


@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """A plane q · p = 1 in the core's frame: inverse depth is q · ray, linear in the image."""

    q: NDArray[np.float64]
    """(3,) 1/mm: the unit normal away from the camera over the distance."""
    covariance: NDArray[np.float64]
    """(3, 3) covariance of q for independent pixels; `depth_variance` accounts for their correlation."""
    middle_mm: NDArray[np.float64]
    """(3,) the mean of its pixels, on the plane."""
    points: int
    """Number of pixels with weight in the fit."""
    pixels: NDArray[np.bool_]
    """(H, W) the pixels of the fit."""
    residual_mm: NDArray[np.float32]
    """(H, W) depth minus the plane's at these pixels, NaN elsewhere."""

    @property
    def normal(self) -> NDArray[np.float64]:
        """Return the unit normal (3,) towards the camera."""
        return -self.q / np.linalg.norm(self.q)

    @property
    def distance_mm(self) -> float:
        """Return the distance of the plane from the camera."""
        return float(1 / np.linalg.norm(self.q))

    def depth_at(self, rays: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the depth (...) mm at which rays (..., 3) x/z, y/z, 1 meet the plane."""
        return 1 / (rays @ self.q)

    def height_above(self, point_mm: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Return the height of a point over the plane, mm, and its derivative (3,) by q."""
        size = float(np.linalg.norm(self.q))
        over = float(self.q @ point_mm) - 1
        return -over / size, -(point_mm / size - over * self.q / size**3)

    def depth_variance(self, area_px: float) -> float:
        """Return the variance of the face's centre along its normal, mm², for a correlation area of ``area_px``."""
        _, slope = self.height_above(self.middle_mm)
        return float(slope @ self.covariance @ slope) * area_px


def fit_face(
    depth: DepthMap, camera: Camera, face_mask: NDArray[np.bool_], expected_mm: NDArray[np.float64]
) -> Face | None:
    """Fit a plane to the interior of ``face_mask`` (H, W), away from its border; None where too little is measured.

    Weights are 1/σ² with Tukey's bisquare in inverse depth, in which a plane is linear and the noise uniform.
    Pixels far off ``expected_mm`` (H, W) are excluded.
    """
    valid = face_mask & depth.measured
    valid &= np.abs(depth.depth_mm - np.where(face_mask, expected_mm, 0)) < _OFF_MM
    if valid.sum() < max(_MIN_PIXELS, 0.3 * face_mask.sum()):
        return None
    inside = _interior_mask(face_mask, valid, MATCHER_REACH_PX * compute_camera_scale(camera))
    if inside.sum() < _MIN_PIXELS:
        return None
    rows, columns = np.nonzero(inside)
    rays = compute_rays(camera, rows, columns)
    z, sigma = depth.depth_mm[inside].astype(np.float64), depth.sigma_mm[inside].astype(np.float64)
    error = np.maximum(sigma, 0.3 * np.median(sigma)) / z**2 + 1e-15
    middle = rays.mean(axis=0)
    local = rays - [middle[0], middle[1], 0]
    weight = np.ones(len(z))
    answer, inverse, spread = np.zeros(3), np.eye(3), 1.0
    for _ in range(8):
        weighted = local * (weight / error**2)[:, None]
        inverse = np.linalg.inv(weighted.T @ local)
        answer = inverse @ (weighted.T @ (1 / z))
        ratio = (1 / z - local @ answer) / error
        spread = MAD_TO_SIGMA * float(np.median(np.abs(ratio))) + 1e-9
        weight = compute_biweights(ratio, spread)
    turn = np.array([[1.0, 0, 0], [0, 1.0, 0], [-middle[0], -middle[1], 1.0]])
    q = turn @ answer
    residual = np.full(depth.depth_mm.shape, np.nan, np.float32)
    residual[inside] = z - 1 / (rays @ q)
    center = middle / (middle @ q)
    return Face(q, spread**2 * turn @ inverse @ turn.T, center, int((weight > 0).sum()), inside, residual)


def compute_rays(
    camera: Camera, rows: NDArray[np.integer], columns: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Return the rays (..., 3) x/z, y/z, 1 of pixels of the undistorted grid."""
    x = (columns - camera.center_px[0]) / camera.focal_px[0]
    y = (rows - camera.center_px[1]) / camera.focal_px[1]
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def _interior_mask(
    face_mask: NDArray[np.bool_], valid: NDArray[np.bool_], reach_px: float
) -> NDArray[np.bool_]:
    """Return the measured pixels at least ``reach_px`` inside the face; of a small face, its inner part."""
    within = np.asarray(ndimage.distance_transform_edt(np.pad(face_mask, 1)))[1:-1, 1:-1]
    return valid & (within > min(reach_px, 0.6 * float(within.max())))


_FARTHEST_PX = 24
"""Largest lag of the autocorrelation."""
_VANISHED = 0.05
"""An autocorrelation below this counts as noise."""


def estimate_correlation_area_px(
    residuals: Sequence[NDArray[np.floating]], farthest_px: int = _FARTHEST_PX
) -> float:
    """Return the number of pixels whose errors act as one: the summed autocorrelation of residuals (h, w).

    Residuals are NaN outside their face. The autocorrelation is pooled over all faces, clipped at three robust
    standard deviations, and summed up to the lag where it vanishes; the result is at least 1.
    """
    side = farthest_px
    total, pairs = np.zeros((2 * side + 1,) * 2), np.zeros((2 * side + 1,) * 2)
    for residual in residuals:
        products, count = _correlate_residuals(residual, side)
        total, pairs = total + products, pairs + count
    if pairs[side, side] == 0 or total[side, side] <= 0:
        return 1.0
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.where(pairs > 50, total / pairs, 0.0) / (total[side, side] / pairs[side, side])
    v, u = np.mgrid[-side : side + 1, -side : side + 1]
    lag = np.rint(np.hypot(u, v)).astype(np.intp)
    rings = np.bincount(lag.ravel(), correlation.ravel())[: side + 1] / np.bincount(lag.ravel())[: side + 1]
    vanished = np.nonzero(rings < _VANISHED)[0]
    reach = int(vanished[0]) if len(vanished) else side
    return float(max(correlation[lag < max(reach, 1)].sum(), 1.0))


def _correlate_residuals(
    residual: NDArray[np.floating], side: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the sums of products (2 side + 1, 2 side + 1) at each lag, and the number of pairs."""
    there = np.isfinite(residual)
    nothing = np.zeros((2 * side + 1,) * 2)
    if there.sum() < 30:
        return nothing, nothing
    rows, columns = (np.nonzero(there.any(axis=axis))[0] for axis in (1, 0))
    window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    there, values = there[window], residual[window].astype(np.float64)
    middle = np.median(values[there])
    spread = MAD_TO_SIGMA * np.median(np.abs(values[there] - middle)) + 1e-12
    values = cast(
        "NDArray[np.float64]", np.where(there, np.clip((np.nan_to_num(values) - middle) / spread, -3, 3), 0)
    )
    shape = [int(fft.next_fast_len(n + 2 * side, real=True)) for n in there.shape]
    sums = [
        np.roll(fft.irfft2(_power_spectrum(field, shape), shape), (side, side), (0, 1))
        for field in (values, there.astype(np.float64))
    ]
    return sums[0][: 2 * side + 1, : 2 * side + 1], np.rint(sums[1][: 2 * side + 1, : 2 * side + 1])


def _power_spectrum(field: NDArray[np.float64], shape: list[int]) -> NDArray[np.float64]:
    return np.abs(fft.rfft2(field, shape)) ** 2
