"""Covariance of a rig to which cameras were added: that of the former rig, and that of the new cameras given it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.assessment.uncertainty.covariance import POSE_NAMES, compute_rig_covariance
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.core.geometry.lens import list_intrinsics
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig

Array = NDArray[np.float64]


def join_covariances(
    rig: Rig,
    joined: Rig,
    adjustment: BundleAdjustmentResult,
    new: tuple[str, ...],
    reference_from_core: Pose,
) -> dict[str, object]:
    """Return the covariance of all cameras; that of the new ones holds for the others as they are."""
    names = [
        f"{name}.{parameter}"
        for name, camera in joined.cameras.items()
        for parameter in list_intrinsics(camera.model)
    ]
    names += [f"{name}.{p}" for name in joined.cameras if name != joined.core for p in POSE_NAMES]
    matrix = np.zeros((len(names), len(names)))
    own = compute_rig_covariance(adjustment)
    former = [each for each in rig.covariance.get("parameters", ()) if each.split(".")[0] not in new]
    _copy_block(
        matrix, names, list(rig.covariance.get("parameters", ())), rig.covariance.get("matrix", ()), former
    )
    is_new = [each for each in own.parameters if each.rsplit(".", 1)[0] in new]
    _copy_block(matrix, names, list(own.parameters), own.matrix, is_new)
    for name in new:
        # a turn about the camera's own axes also moves the core's origin, which lies off the reference's
        lever = adjustment.rig.cam_from_core[name].rotation @ reference_from_core.translation_mm
        place = [names.index(f"{name}.{p}") for p in POSE_NAMES]
        jacobian = np.eye(len(names))
        jacobian[np.ix_(place[3:], place[:3])] = -_skew(lever)
        matrix = jacobian @ matrix @ jacobian.T
    return {"parameters": names, "matrix": matrix}


def _copy_block(
    matrix: Array, names: list[str], source_names: list[str], source: object, chosen: list[str]
) -> None:
    """Copy the rows and columns of some parameters."""
    if not chosen:
        return
    to, at = [names.index(each) for each in chosen], [source_names.index(each) for each in chosen]
    matrix[np.ix_(to, to)] = np.asarray(source, np.float64)[np.ix_(at, at)]


def _skew(v: Array) -> Array:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
