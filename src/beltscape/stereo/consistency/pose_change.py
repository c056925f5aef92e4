"""Pose change of one camera that best explains the residuals of a frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.residuals import compute_disparity_residuals, compute_pair_residuals
from beltscape.stereo.consistency.tie_points import Array, TiePoints

_LOSS_PX = 0.5
"""Scale of Cauchy's loss; larger residuals are false matches and weigh less."""
_BOUND = np.array([0.2, 0.2, 0.2, 100.0, 100.0, 100.0])
"""rad and mm; beyond these the search would not have found the points."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseChange:
    """Movement of one camera, in its own frame."""

    camera: str
    angle_deg: float
    shift_mm: float
    rig: Rig
    """The rig after the movement."""


def fit_pose_change(tie_points: TiePoints, rig: Rig, camera: str, auxiliaries: Sequence[str]) -> PoseChange:
    """Fit the rotation and shift of a camera to the tie points of these auxiliaries."""

    def compute_residuals(change: Array) -> Array:
        values = _stack_residuals(tie_points, apply_pose_change(rig, camera, change), auxiliaries)
        return np.nan_to_num(values, nan=0.0)

    scale = np.array([1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0])
    start = np.zeros(6)
    for loss in (10 * _LOSS_PX, _LOSS_PX):  # wide first, so that a large movement is no outlier
        fitted = least_squares(
            compute_residuals,
            start,
            loss="cauchy",
            f_scale=loss,
            x_scale=scale,
            bounds=(-_BOUND, _BOUND),
            max_nfev=30,
        )
        start = fitted.x
    change = fitted.x
    return PoseChange(
        camera,
        float(np.rad2deg(np.linalg.norm(change[:3]))),
        float(np.linalg.norm(change[3:])),
        apply_pose_change(rig, camera, change),
    )


def apply_pose_change(rig: Rig, camera: str, change: Array) -> Rig:
    """Return the rig with a camera turned by (3,) rad about its centre and shifted by (3,) mm, in its frame."""
    movement = Pose.of(np.asarray(change[:3], np.float64), change[3:])
    if camera != rig.core:
        return replace(rig, cam_from_core={**rig.cam_from_core, camera: movement @ rig.cam_from_core[camera]})
    inverse = movement.inverse()
    poses = {name: pose if name == camera else pose @ inverse for name, pose in rig.cam_from_core.items()}
    return replace(rig, cam_from_core=poses)


def _stack_residuals(tie_points: TiePoints, rig: Rig, auxiliaries: Sequence[str]) -> Array:
    """Return all epipolar residuals, and the disparity residuals of all pairs of auxiliaries, px."""
    residuals = [compute_pair_residuals(tie_points, rig, name) for name in auxiliaries]
    epipolar = [each.epipolar_px for each in residuals]
    disparity = [
        compute_disparity_residuals(one, other)
        for i, one in enumerate(residuals)
        for other in residuals[i + 1 :]
    ]
    return np.concatenate(epipolar + disparity)
