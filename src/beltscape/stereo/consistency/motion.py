"""The movement of one camera that explains the residuals of a frame best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from beltscape.core.pose import Pose
from beltscape.core.rig import Rig
from beltscape.stereo.consistency.residuals import disparity_px, pair_residuals
from beltscape.stereo.consistency.tie_points import Array, TiePoints

_LOSS_PX = 0.5
"""Residuals beyond this count less (Cauchy's loss): false matches."""
_BOUND = np.array([0.2, 0.2, 0.2, 100.0, 100.0, 100.0])
"""rad and mm: farther, the search would not have found the points."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Of one camera, in its own frame."""

    camera: str
    angle_deg: float
    shift_mm: float
    rig: Rig
    """The rig after it."""


def fit_motion(tie: TiePoints, rig: Rig, camera: str, auxiliaries: Sequence[str]) -> Motion:
    """Fit the rotation and shift of a camera to the tie points of it and the auxiliaries named."""

    def residuals(change: Array) -> Array:
        values = _all_px(tie, moved_rig(rig, camera, change), auxiliaries)
        return np.nan_to_num(values, nan=0.0)

    scale = np.array([1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0])
    start = np.zeros(6)
    for loss in (10 * _LOSS_PX, _LOSS_PX):  # wide first: a large motion is no outlier
        fitted = least_squares(
            residuals,
            start,
            loss="cauchy",
            f_scale=loss,
            x_scale=scale,
            bounds=(-_BOUND, _BOUND),
            max_nfev=30,
        )
        start = fitted.x
    change = fitted.x
    return Motion(
        camera,
        float(np.rad2deg(np.linalg.norm(change[:3]))),
        float(np.linalg.norm(change[3:])),
        moved_rig(rig, camera, change),
    )


def moved_rig(rig: Rig, camera: str, change: Array) -> Rig:
    """Return the rig with a camera turned by (3,) rad about its centre and shifted by (3,) mm, in its frame."""
    motion = Pose.of(np.asarray(change[:3], np.float64), change[3:])
    if camera != rig.core:
        return replace(rig, cam_from_core={**rig.cam_from_core, camera: motion @ rig.cam_from_core[camera]})
    back = motion.inverse()
    poses = {name: pose if name == camera else pose @ back for name, pose in rig.cam_from_core.items()}
    return replace(rig, cam_from_core=poses)


def _all_px(tie: TiePoints, rig: Rig, auxiliaries: Sequence[str]) -> Array:
    """Every residual across, and every difference along between neighbours in the list, px."""
    residuals = [pair_residuals(tie, rig, name) for name in auxiliaries]
    across = [each.across_px for each in residuals]
    between = [disparity_px(one, other) for i, one in enumerate(residuals) for other in residuals[i + 1 :]]
    return np.concatenate(across + between)
