"""Residuals of tie points under a rig: epipolar residuals and differences of disparity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.tie_points.tie_points import Array, TiePoints


@dataclass(frozen=True, slots=True, eq=False)
class PairResiduals:
    """Residuals of one auxiliary against the core; NaN where a point was not found."""

    epipolar_px: Array
    """(N,) signed distance from the epipolar line in the undistorted auxiliary image."""
    inverse_depth: Array
    """(N,) 1/mm, triangulated: the point of the core's ray that is nearest to the auxiliary's."""
    sensitivity_px_mm: Array
    """(N,) displacement of the point along the epipolar line per 1/mm of inverse depth."""


def compute_pair_residuals(tie_points: TiePoints, rig: Rig, name: str) -> PairResiduals:
    """Return the residuals of the tie points in one auxiliary image."""
    core, camera, pose = rig.core_camera, rig.cameras[name], rig.cam_from_core[name]
    rays = np.concatenate(
        [(tie_points.core_px - core.center_px) / core.focal_px, np.ones((len(tie_points.core_px), 1))], axis=1
    )
    directions, shift = rays @ pose.rotation.T, pose.translation_mm
    observed = camera.undistort(tie_points.observed_px[name])
    observed = np.concatenate([observed, np.ones((len(observed), 1))], axis=1)
    inverse_depth = _triangulate(observed, directions, shift)
    start = directions + tie_points.inverse_depth[:, None] * shift
    with np.errstate(invalid="ignore", divide="ignore"):
        # derivative of the pixel with respect to the inverse depth: the direction of the epipolar line
        along = (shift[:2] - start[:, :2] / start[:, 2:] * shift[2]) / start[:, 2:] * camera.focal_px
        length = np.linalg.norm(along, axis=1)
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / length[:, None]
        offset = (observed[:, :2] - start[:, :2] / start[:, 2:]) * camera.focal_px
        epipolar = (offset * normal).sum(axis=1)
    return PairResiduals(epipolar, inverse_depth, length)


def _triangulate(observed: Array, directions: Array, shift: Array) -> Array:
    """Return (N,) s with directions + s · shift nearest to the observed rays (least squares of the cross product)."""
    across = np.cross(observed, np.broadcast_to(shift, observed.shape))
    with np.errstate(invalid="ignore", divide="ignore"):
        return -(across * np.cross(observed, directions)).sum(axis=1) / (across * across).sum(axis=1)


def compute_disparity_residuals(one: PairResiduals, other: PairResiduals) -> Array:
    """Return the difference of two auxiliaries' inverse depths as disparity, (N,) px.

    Errors of one pixel in either image give it a standard deviation of 1.
    """
    a, b = one.sensitivity_px_mm, other.sensitivity_px_mm
    return (one.inverse_depth - other.inverse_depth) * a * b / np.hypot(a, b)
