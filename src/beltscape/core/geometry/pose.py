"""Rigid transforms, named by their coordinate frames: ``a_from_c = a_from_b @ b_from_c``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beltscape.core.checks import require_array, require_instance
from beltscape.core.errors import ArgumentError

_ORTHONORMAL = 1e-6
"""Largest error of an element of R Rᵀ: the program writes all digits, and 1e-6 rad moves no pixel noticeably."""
_CLEARLY_ORTHONORMAL = 5e-7
"""Largest error at which plain floats accept R: half of `_ORTHONORMAL`, so that roundings decide nothing."""
_SMALL_RAD = 1e-8
"""Below this angle the series is used: its error is the angle's cube, and (1 - cos a) / a² loses its digits."""
_TINY_SINE = 1e-12
"""Below this sine of half the angle, 2 asin(x) / x is 2 to all digits of a double."""


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Rigid transform: ``x_b = rotation @ x_a + translation_mm``."""

    rotation: NDArray[np.float64]
    """(3, 3) float64, orthonormal, determinant +1."""
    translation_mm: NDArray[np.float64]
    """(3,) float64, millimetres."""

    def __post_init__(self) -> None:
        """Raise ArgumentError unless they are a rotation and a translation."""
        require_array(self.rotation, "rotation", (3, 3))
        require_array(self.translation_mm, "translation_mm", (3,))
        if not is_rotation(self.rotation) and np.isfinite(self.rotation).all():
            raise ArgumentError(
                "rotation is no rotation: its rows must be of length 1 and at right angles, its determinant +1"
            )

    @classmethod
    def of(cls, rotation: ArrayLike, translation_mm: ArrayLike) -> Pose:
        """Return the pose of array-like arguments; a (3,) rotation is a rotation vector in radians."""
        try:
            matrix = np.array(rotation, dtype=np.float64)
            translation = np.array(translation_mm, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ArgumentError(f"rotation and translation_mm must be numbers ({error})") from error
        if matrix.size not in (3, 9) or translation.size != 3:
            raise ArgumentError(
                f"rotation has {matrix.size} numbers, translation_mm {translation.size}: they must have 9, or 3 as a "
                "rotation vector, and 3"
            )
        if matrix.size == 3:
            matrix = rotation_from_vector(matrix.reshape(3))
        return cls(matrix.reshape(3, 3), translation.reshape(3))

    @classmethod
    def identity(cls) -> Pose:
        """Return the identity transform."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def placing(
        cls, rotation: NDArray[np.float64], point_mm: NDArray[np.float64], place_mm: NDArray[np.float64]
    ) -> Pose:
        """Return the pose of a rotation (3, 3) that brings a point (3,) of frame a to a place (3,) of frame b."""
        return cls(rotation, place_mm - rotation @ point_mm)

    def __matmul__(self, other: Pose) -> Pose:
        """Compose: ``a_from_b @ b_from_c`` is ``a_from_c``."""
        require_instance(other, Pose, "the second pose", "bs.Pose.of(rotation, translation_mm)")
        return Pose(
            self.rotation @ other.rotation, self.rotation @ other.translation_mm + self.translation_mm
        )

    def inverse(self) -> Pose:
        """Return the inverse transform."""
        return Pose(self.rotation.T.copy(), -self.rotation.T @ self.translation_mm)

    def apply(self, points_mm: NDArray[np.floating]) -> NDArray[np.float64]:
        """Transform points (..., 3) in mm from frame a to frame b."""
        return points_mm @ self.rotation.T + self.translation_mm

    @property
    def rotation_vector(self) -> NDArray[np.float64]:
        """The rotation vector (3,): axis times angle, radians."""
        return vector_from_rotation(self.rotation)

    @property
    def center_mm(self) -> NDArray[np.float64]:
        """Frame b's origin (3,) in frame a; for a ``cam_from_x`` the camera's centre."""
        return -self.rotation.T @ self.translation_mm

    @property
    def angle_deg(self) -> float:
        """The rotation's angle, degrees."""
        return float(np.rad2deg(np.linalg.norm(self.rotation_vector)))


def rotation_from_vector(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation matrix (3, 3) of a rotation vector (3,) in radians (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    skew = np.array(
        [[0.0, -vector[2], vector[1]], [vector[2], 0.0, -vector[0]], [-vector[1], vector[0], 0.0]]
    )
    if angle < _SMALL_RAD:
        return np.eye(3) + skew + 0.5 * skew @ skew
    return np.eye(3) + np.sin(angle) / angle * skew + (1 - np.cos(angle)) / angle**2 * skew @ skew


def is_rotation(matrix: NDArray[np.float64]) -> bool:
    """Return whether a matrix (3, 3) is orthonormal, up to rounding, with determinant +1."""
    if _is_clearly_rotation(matrix):
        return True
    is_orthonormal = np.allclose(matrix @ matrix.T, np.eye(3), rtol=0, atol=_ORTHONORMAL)
    return bool(is_orthonormal and np.linalg.det(matrix) >= 0)


def _is_clearly_rotation(matrix: NDArray[np.float64]) -> bool:
    """Return whether nine plain floats show a rotation, in a twentieth of the time that arrays of nine take."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    return (
        abs(a * a + b * b + c * c - 1) < _CLEARLY_ORTHONORMAL
        and abs(d * d + e * e + f * f - 1) < _CLEARLY_ORTHONORMAL
        and abs(g * g + h * h + i * i - 1) < _CLEARLY_ORTHONORMAL
        and abs(a * d + b * e + c * f) < _CLEARLY_ORTHONORMAL
        and abs(a * g + b * h + c * i) < _CLEARLY_ORTHONORMAL
        and abs(d * g + e * h + f * i) < _CLEARLY_ORTHONORMAL
        and a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0
    )


def vector_from_rotation(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation vector (3,) in radians of a rotation matrix (3, 3), through the unit quaternion."""
    r = rotation
    trace = np.trace(r)
    # q qᵀ as a symmetric matrix: its column with the largest diagonal is best conditioned
    k = np.empty((4, 4))
    k[0, 0] = 1 + trace
    k[1:, 0] = k[0, 1:] = [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]
    k[1:, 1:] = r + r.T + (1 - trace) * np.eye(3)
    quaternion = k[:, int(np.argmax(np.diag(k)))]
    quaternion = quaternion / np.linalg.norm(quaternion)
    if quaternion[0] < 0:
        quaternion = -quaternion
    sine = float(np.linalg.norm(quaternion[1:]))
    if sine < _TINY_SINE:
        return 2.0 * quaternion[1:]
    return quaternion[1:] * (2.0 * np.arctan2(sine, quaternion[0]) / sine)
