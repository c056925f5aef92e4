"""Unit quaternions (w, x, y, z), as COLMAP and ROS give rotations; Hamilton's convention, like Eigen's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.files.exchange.values import ROUNDED


def wxyz_from_rotation(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit quaternion (4,) with w ≥ 0 of a rotation matrix (3, 3)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True)


def rotation_from_wxyz(wxyz: NDArray[np.float64], place: str) -> NDArray[np.float64]:
    """Return the rotation matrix (3, 3) of a quaternion; ValueError unless its length is 1 up to rounding."""
    from scipy.spatial.transform import Rotation

    length = float(np.linalg.norm(wxyz))
    if abs(length - 1) > ROUNDED:
        raise ValueError(f"{place} = {wxyz.tolist()}: must be a unit quaternion, its length is {length:.4g}")
    return Rotation.from_quat(wxyz, scalar_first=True).as_matrix()
