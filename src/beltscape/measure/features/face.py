"""A flat upper face: a weighted plane through its interior, with the covariance that correlated errors leave it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap
from beltscape.measure.features.view import MATCHER_REACH_PX, scale_of

_LEAST = 30
"""Pixels that a plane needs."""
_OFF_MM = 3.0
"""A face farther than this from where the perfect module has it is not the module's."""


@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """A plane q · p = 1 in the core's frame: inverse depth is q · ray, linear in the image."""

    q: NDArray[np.float64]
    """(3,) 1/mm: the unit normal away from the camera over the distance."""
    covariance: NDArray[np.float64]
    """(3, 3) of q, for errors that go together over `area_px` = 1; see `widened`."""
    middle_mm: NDArray[np.float64]
    """(3,) the mean of its pixels, on the plane."""
    points: int
    """Pixels it was fitted to."""
    pixels: NDArray[np.bool_]
    """(H, W) which."""
    residual_mm: NDArray[np.float32]
    """(H, W) depth minus the plane's at these pixels, NaN elsewhere."""

    @property
    def normal(self) -> NDArray[np.float64]:
        """(3,) unit, towards the camera."""
        return -self.q / np.linalg.norm(self.q)

    @property
    def distance_mm(self) -> float:
        """Of the plane from the camera."""
        return float(1 / np.linalg.norm(self.q))

    def depth_at(self, rays: NDArray[np.float64]) -> NDArray[np.float64]:
        """(...) depth, mm, where rays (..., 3) x/z, y/z, 1 meet it."""
        return 1 / (rays @ self.q)

    def above(self, point_mm: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Height of a point over the plane, mm, and its slope (3,) by q."""
        size = float(np.linalg.norm(self.q))
        over = float(self.q @ point_mm) - 1
        return -over / size, -(point_mm / size - over * self.q / size**3)

    def depth_variance(self, area_px: float) -> float:
        """Of the face's middle along its normal, mm²: errors of ``area_px`` pixels act as one."""
        _, slope = self.above(self.middle_mm)
        return float(slope @ self.covariance @ slope) * area_px


def fit_face(
    depth: DepthMap, camera: Camera, shown: NDArray[np.bool_], expected_mm: NDArray[np.float64]
) -> Face | None:
    """Plane through the interior of ``shown`` (H, W), away from its border; None where too little is measured.

    Weighted by 1/σ² with Tukey's bisquare in inverse depth, where a plane is linear and the noise even.
    Pixels far off ``expected_mm`` (H, W) are not the face's.
    """
    seen = shown & depth.measured
    seen &= np.abs(depth.depth_mm - np.where(shown, expected_mm, 0)) < _OFF_MM
    if seen.sum() < max(_LEAST, 0.3 * shown.sum()):
        return None
    inside = _interior(shown, seen, MATCHER_REACH_PX * scale_of(camera))
    if inside.sum() < _LEAST:
        return None
    rows, columns = np.nonzero(inside)
    rays = rays_at(camera, rows, columns)
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
        spread = 1.4826 * float(np.median(np.abs(ratio))) + 1e-9
        weight = np.clip(1 - (ratio / (4.685 * spread)) ** 2, 0, None) ** 2
    turn = np.array([[1.0, 0, 0], [0, 1.0, 0], [-middle[0], -middle[1], 1.0]])
    q = turn @ answer
    residual = np.full(depth.depth_mm.shape, np.nan, np.float32)
    residual[inside] = z - 1 / (rays @ q)
    center = middle / (middle @ q)
    return Face(q, spread**2 * turn @ inverse @ turn.T, center, int((weight > 0).sum()), inside, residual)


def rays_at(camera: Camera, rows: NDArray[np.integer], columns: NDArray[np.integer]) -> NDArray[np.float64]:
    """(..., 3) x/z, y/z, 1 of pixels of the undistorted grid."""
    x = (columns - camera.center_px[0]) / camera.focal_px[0]
    y = (rows - camera.center_px[1]) / camera.focal_px[1]
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def _interior(shown: NDArray[np.bool_], seen: NDArray[np.bool_], reach_px: float) -> NDArray[np.bool_]:
    """Pixels that far inside the face; of a small face, its inner third."""
    within = np.asarray(ndimage.distance_transform_edt(np.pad(shown, 1)))[1:-1, 1:-1]
    return seen & (within > min(reach_px, 0.6 * float(within.max())))
