"""Chains of measured pairs between cameras, with first-order propagation of the pairs' errors.

Errors are vectors of the Lie group SE(3), (rotation in rad, translation in mm). A twist ξ = (ω, v) stands for
``exp(ξ)``, the rigid motion that it generates in unit time; ``pose @ exp(ξ)`` perturbs a pose on its right, in its
source frame, ``exp(ξ) @ pose`` on its left, in its target frame.

References
----------
Barfoot, State Estimation for Robotics, 2017, Section 7.1; Solà, Deray & Atchuthan, arXiv:1812.01537.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.linalg import inv

from beltscape.calibration.network.pairs import Pair
from beltscape.core.arrays import Array
from beltscape.core.geometry.pose import Pose

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


@dataclass(frozen=True, slots=True, eq=False)
class PoseChain:
    """A measured chain between two cameras, ``pose = true @ exp(jacobian ξ)``; ξ (6P,) are all pairs' errors."""

    pose: Pose
    jacobian: Array
    """(6, 6P)."""

    def extend(self, other: PoseChain) -> PoseChain:
        """Return the chain extended by ``other``, which starts where this one ends."""
        return PoseChain(
            other.pose @ self.pose, adjoint(self.pose.inverse()) @ other.jacobian + self.jacobian
        )


def find_pair_chain(pairs: Sequence[Pair], origin: str, to: str) -> PoseChain:
    """Return the measured pair between two cameras as a chain ``to_from_origin``.

    Raises
    ------
    KeyError
        When the two cameras are no measured pair.
    """
    jacobian = np.zeros((6, 6 * len(pairs)))
    for i, pair in enumerate(pairs):
        if (pair.first, pair.second) == (origin, to):
            jacobian[:, 6 * i : 6 * i + 6] = np.eye(6)
            return PoseChain(pair.second_from_first, jacobian)
        if (pair.first, pair.second) == (to, origin):
            jacobian[:, 6 * i : 6 * i + 6] = -adjoint(pair.second_from_first)
            return PoseChain(pair.second_from_first.inverse(), jacobian)
    raise KeyError((origin, to))


def list_triangles(pairs: Sequence[Pair], cameras: Iterable[str]) -> list[tuple[str, str, str]]:
    """Return every three of some cameras with three measured pairs, in the pairs' order."""
    known = {frozenset((pair.first, pair.second)) for pair in pairs}
    wanted = set(cameras)
    names = dict.fromkeys(name for pair in pairs for name in (pair.first, pair.second) if name in wanted)
    return [
        three
        for three in combinations(names, 3)
        if all(frozenset(two) in known for two in combinations(three, 2))
    ]


def compute_joint_covariance(pairs: Sequence[Pair]) -> Array:
    """Return the covariance (6P, 6P) of the errors of all pairs, correlated by the corners that they share."""
    joint = np.zeros((6 * len(pairs), 6 * len(pairs)))
    by_camera: dict[str, list[int]] = {}
    for i, pair in enumerate(pairs):
        if not pair.sensitivity:
            joint[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = pair.covariance
        for name in pair.sensitivity:
            by_camera.setdefault(name, []).append(i)
    for name, own in by_camera.items():
        columns = np.concatenate([np.arange(6 * i, 6 * i + 6) for i in own])
        shared = np.concatenate([pairs[i].sensitivity[name] for i in own], axis=1)
        joint[np.ix_(columns, columns)] += shared.T @ shared
    return joint
