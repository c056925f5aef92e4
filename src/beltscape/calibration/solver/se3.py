"""The Lie group SE(3): conversion of rigid transforms to 6-vectors (rotation in rad, translation in mm) and back.

A twist ξ = (ω, v) stands for ``exp(ξ)``, the rigid motion that it generates in unit time; ``pose @ exp(ξ)`` perturbs
a pose on its right, in its source frame, ``exp(ξ) @ pose`` on its left, in its target frame.

References
----------
Barfoot, State Estimation for Robotics, 2017, Section 7.1; Solà, Deray & Atchuthan, arXiv:1812.01537.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import inv

from beltscape.core.geometry.pose import Pose

Array = NDArray[np.float64]

SERIES_BELOW = 1.0
"""Angle, rad, below which the Jacobian's series is summed: the closed form loses digits by cancellation."""
SERIES_TERMS = 18
"""At 1 rad the next term, 1/19!, is below rounding."""
NEGLIGIBLE = 1e-18
"""Share of the sum below which a term, and all after it, are lost in rounding."""


def exp(twist: Array) -> Pose:
    """Return the pose of a twist (6,)."""
    rotation_vector, translation = twist[:3], twist[3:]
    return Pose.of(rotation_vector, _left_rotation_jacobian(rotation_vector) @ translation)


def log(pose: Pose) -> Array:
    """Return the twist (6,) of a pose, its angle in 0..π: the inverse of `exp`."""
    rotation_vector = pose.rotation_vector
    angle = float(np.linalg.norm(rotation_vector))
    cross = skew(rotation_vector)
    # (1 - (a/2) cot(a/2)) / a²: a twelfth at 0, and cot is 0 at π
    if angle < 1e-2:
        square = 1 / 12 + angle**2 / 720 + angle**4 / 30240
    else:
        square = (1 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
    inverse = np.eye(3) - 0.5 * cross + square * cross @ cross
    return np.concatenate([rotation_vector, inverse @ pose.translation_mm])


def skew(vector: Array) -> Array:
    """Return the matrix (3, 3) of the cross product with a vector (3,)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def adjoint(pose: Pose) -> Array:
    """Return Ad (6, 6) with ``pose @ exp(ξ) = exp(Ad ξ) @ pose``."""
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = matrix[3:, 3:] = pose.rotation
    matrix[3:, :3] = skew(pose.translation_mm) @ pose.rotation
    return matrix


def small_adjoint(twist: Array) -> Array:
    """Return ad (6, 6) with ``adjoint(exp(ξ)) = expm(ad ξ)``."""
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = matrix[3:, 3:] = skew(twist[:3])
    matrix[3:, :3] = skew(twist[3:])
    return matrix


def left_jacobian(twist: Array) -> Array:
    """Return J (6, 6) with ``exp(ξ + δ) ≈ exp(J δ) @ exp(ξ)``: Σ adⁿ / (n + 1)!."""
    ad = small_adjoint(twist)
    a = float(np.linalg.norm(twist[:3]))
    if a < SERIES_BELOW:
        total = term = np.eye(6)
        for n in range(1, SERIES_TERMS):
            term = term @ ad / (n + 1)
            total = total + term
            if np.abs(term).max() < NEGLIGIBLE * np.abs(total).max():
                break
        return total
    sine, cosine = np.sin(a), np.cos(a)
    square = ad @ ad
    return (
        np.eye(6)
        + (4 - a * sine - 4 * cosine) / (2 * a**2) * ad
        + (4 * a - 5 * sine + a * cosine) / (2 * a**3) * square
        + (2 - a * sine - 2 * cosine) / (2 * a**4) * square @ ad
        + (2 * a - 3 * sine + a * cosine) / (2 * a**5) * square @ square
    )


def left_jacobian_inverse(twist: Array) -> Array:
    """Return J⁻¹ (6, 6) with ``log(exp(δ) @ exp(ξ)) ≈ ξ + J⁻¹ δ``."""
    return inv(left_jacobian(twist))


def _left_rotation_jacobian(rotation_vector: Array) -> Array:
    """Return the left Jacobian (3, 3) of a rotation vector, which maps a twist's v to the pose's translation."""
    angle = float(np.linalg.norm(rotation_vector))
    cross = skew(rotation_vector)
    if angle < 1e-2:
        once, twice = 0.5 - angle**2 / 24 + angle**4 / 720, 1 / 6 - angle**2 / 120 + angle**4 / 5040
    else:
        once = 2 * np.sin(0.5 * angle) ** 2 / angle**2
        twice = (angle - np.sin(angle)) / angle**3
    return np.eye(3) + once * cross + twice * cross @ cross
