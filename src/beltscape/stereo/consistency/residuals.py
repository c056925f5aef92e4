"""Residuals of tie points under a rig: across the epipolar line, and the inverse depth along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltscape.core.rig import Rig
from beltscape.stereo.consistency.tie_points import Array, TiePoints


@dataclass(frozen=True, slots=True, eq=False)
class PairResiduals:
    """Of one auxiliary; NaN where a point was not found."""

    across_px: Array
    """(N,) signed distance from the epipolar line in the undistorted auxiliary image."""
    inverse_depth: Array
    """(N,) 1/mm of the point of the core's ray that comes nearest."""
    sensitivity_px_mm: Array
    """(N,) how far the point moves along the line per 1/mm of inverse depth."""


def pair_residuals(tie: TiePoints, rig: Rig, name: str) -> PairResiduals:
    """Return what the correspondences in one auxiliary image say of it."""
    core, camera, pose = rig.core_camera, rig.cameras[name], rig.cam_from_core[name]
    rays = np.concatenate(
        [(tie.core_px - core.center_px) / core.focal_px, np.ones((len(tie.core_px), 1))], axis=1
    )
    far, shift = rays @ pose.rotation.T, pose.translation_mm
    seen = camera.undistort(tie.found_px[name])
    seen = np.concatenate([seen, np.ones((len(seen), 1))], axis=1)
    inverse = _nearest(seen, far, shift)
    start = far + tie.inverse_depth[:, None] * shift
    with np.errstate(invalid="ignore", divide="ignore"):
        # derivative of the pixel by the inverse depth: the direction of the epipolar line
        along = (shift[:2] - start[:, :2] / start[:, 2:] * shift[2]) / start[:, 2:] * camera.focal_px
        length = np.linalg.norm(along, axis=1)
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / length[:, None]
        offset = (seen[:, :2] - start[:, :2] / start[:, 2:]) * camera.focal_px
        across = (offset * normal).sum(axis=1)
    return PairResiduals(across, inverse, length)


def _nearest(seen: Array, far: Array, shift: Array) -> Array:
    """Return (N,) s that brings far + s · shift nearest to the rays seen (least squares of the cross product)."""
    across = np.cross(seen, np.broadcast_to(shift, seen.shape))
    with np.errstate(invalid="ignore", divide="ignore"):
        return -(across * np.cross(seen, far)).sum(axis=1) / (across * across).sum(axis=1)


def disparity_px(one: PairResiduals, other: PairResiduals) -> Array:
    """Return (N,) px by which two auxiliaries' inverse depths differ.

    The difference of depths that errors of one pixel in either image make has a standard deviation of 1.
    """
    a, b = one.sensitivity_px_mm, other.sensitivity_px_mm
    return (one.inverse_depth - other.inverse_depth) * a * b / np.hypot(a, b)
