"""Pose change of one camera that best explains the residuals of a frame, with its covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.stereo.consistency.residual_reference import ResidualReference
from beltscape.stereo.consistency.residuals import compute_disparity_residuals, compute_pair_residuals
from beltscape.stereo.consistency.systematic_residual import BLOCKS
from beltscape.stereo.consistency.tie_points.tie_points import Array, TiePoints

_LOSS_PX = 0.5
"""Scale of Cauchy's loss; larger residuals are false matches and weigh less."""
_BOUND = np.array([0.2, 0.2, 0.2, 100.0, 100.0, 100.0])
"""rad and mm; beyond these the search would not have found the points."""
_KNOCK = 2.0, 20.0
"""A knock turns a camera by less (°) and shifts it by less (mm); a larger pose change that explains a frame arises by
chance among images of other cameras."""
_BIAS_PX = 0.01
"""Systematic error of the matching in one block; rendered captures under their true rigs have 0.005 px."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseChange:
    """Movement of one camera, in its own frame."""

    camera: str
    angle_deg: float
    shift_mm: float
    rig: Rig
    """The rig after the movement."""
    change: Array
    """(6,) rotation vector, rad, and shift of the camera frame, mm."""
    covariance: Array
    """(6, 6) of the change."""

    @property
    def is_plausible(self) -> bool:
        """Return whether a knock may have moved the camera by this."""
        return self.angle_deg < _KNOCK[0] and self.shift_mm < _KNOCK[1]

    @property
    def angle_sigma_deg(self) -> float:
        """Return one standard deviation of the angle."""
        return float(np.rad2deg(_compute_length_sigma(self.change[:3], self.covariance[:3, :3])))

    @property
    def shift_sigma_mm(self) -> float:
        """Return one standard deviation of the shift's length."""
        return _compute_length_sigma(self.change[3:], self.covariance[3:, 3:])


def fit_pose_change(
    tie_points: TiePoints,
    rig: Rig,
    camera: str,
    auxiliaries: Sequence[str],
    reference: ResidualReference | None = None,
) -> PoseChange:
    """Fit the rotation and shift of a camera to the residuals of these auxiliaries, less those of the reference."""
    from scipy.optimize import least_squares  # takes longer to import than a sound frame's whole check

    def compute_residuals(change: Array) -> Array:
        return _stack_residuals(tie_points, apply_pose_change(rig, camera, change), auxiliaries, reference)

    found = np.isfinite(compute_residuals(np.zeros(6)))
    scale = np.array([1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0])
    start = np.zeros(6)
    for loss in (10 * _LOSS_PX, _LOSS_PX):  # wide first, so that a large movement is no outlier
        fitted = least_squares(
            lambda change: np.nan_to_num(compute_residuals(change), nan=0.0),
            start,
            loss="cauchy",
            f_scale=loss,
            x_scale=scale,
            bounds=(-_BOUND, _BOUND),
            max_nfev=30,
        )
        start = fitted.x
    change = np.asarray(fitted.x, np.float64)
    scatter = (
        MAD_TO_SIGMA * float(np.median(np.abs(compute_residuals(change)[found]))) if found.any() else 1.0
    )
    # residuals of disparity are twice as many as the auxiliaries leave free; a block's bias is common to its points
    per_block = len(tie_points.core_px) / (BLOCKS[0] * BLOCKS[1])
    variance = 2 * scatter**2 + per_block * (_BIAS_PX * tie_points.pixel_scale) ** 2
    normal = np.asarray(fitted.jac.T @ fitted.jac, np.float64)
    inverse = np.linalg.pinv(normal * np.outer(scale, scale)) * np.outer(scale, scale)
    covariance = np.asarray(variance * inverse, np.float64)
    return PoseChange(
        camera,
        float(np.rad2deg(np.linalg.norm(change[:3]))),
        float(np.linalg.norm(change[3:])),
        apply_pose_change(rig, camera, change),
        change,
        covariance,
    )


def apply_pose_change(rig: Rig, camera: str, change: Array) -> Rig:
    """Return the rig with a camera turned by (3,) rad about its centre and shifted by (3,) mm, in its frame."""
    movement = Pose.of(np.asarray(change[:3], np.float64), change[3:])
    if camera != rig.core:
        return replace(rig, cam_from_core={**rig.cam_from_core, camera: movement @ rig.cam_from_core[camera]})
    inverse = movement.inverse()
    poses = {name: pose if name == camera else pose @ inverse for name, pose in rig.cam_from_core.items()}
    return replace(rig, cam_from_core=poses)


def _compute_length_sigma(vector: Array, covariance: Array) -> float:
    """Return one standard deviation of a vector's length."""
    length = float(np.linalg.norm(vector))
    if not length:
        return float(np.sqrt(np.trace(covariance)))
    unit = vector / length
    return float(np.sqrt(unit @ covariance @ unit))


def _stack_residuals(
    tie_points: TiePoints, rig: Rig, auxiliaries: Sequence[str], reference: ResidualReference | None
) -> Array:
    """Return all epipolar residuals, and the disparity residuals of all pairs of auxiliaries, px; NaN: not found."""
    pixels = tie_points.core_px
    residuals = {name: compute_pair_residuals(tie_points, rig, name) for name in auxiliaries}
    stacked: list[Array] = []
    for name, each in residuals.items():
        epipolar = each.epipolar_px
        stacked.append(epipolar if reference is None else reference.subtract_epipolar(epipolar, pixels, name))
    for one, other in combinations(auxiliaries, 2):
        disparity = compute_disparity_residuals(residuals[one], residuals[other])
        if reference is not None:
            disparity = reference.subtract_disparity(disparity, pixels, (one, other))
        stacked.append(disparity)
    return np.concatenate(stacked)
