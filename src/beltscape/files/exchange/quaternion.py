"""Unit quaternions (w, x, y, z), as COLMAP and ROS give rotations; Hamilton's convention, like Eigen's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.pose import vector_from_rotation
from beltscape.files.exchange.values import ROUNDED


def wxyz_from_rotation(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit quaternion (4,) with w ≥ 0 of a rotation matrix (3, 3)."""
    vector = vector_from_rotation(rotation)
    half = float(np.linalg.norm(vector)) / 2
    return np.array([np.cos(half), *(0.5 * np.sinc(half / np.pi) * vector)])


def rotation_from_wxyz(wxyz: NDArray[np.float64], place: str) -> NDArray[np.float64]:
    """Return the rotation matrix (3, 3) of a quaternion; ValueError unless its length is 1 up to rounding."""
    length = float(np.linalg.norm(wxyz))
    if abs(length - 1) > ROUNDED:
        raise ValueError(f"{place} = {wxyz.tolist()}: must be a unit quaternion, its length is {length:.4g}")
    w, v = wxyz[0] / length, wxyz[1:] / length
    skew = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.eye(3) + 2 * w * skew + 2 * skew @ skew
