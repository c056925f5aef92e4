"""Chains of measured pairs between cameras, with first-order propagation of the pairs' errors."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.network.pairs import Pair
from beltscape.calibration.solver.se3 import adjoint
from beltscape.core.geometry.pose import Pose

Array = NDArray[np.float64]


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
