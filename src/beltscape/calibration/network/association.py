"""Multi-camera association: the cameras of all pairs in the core camera's frame (the paper's Section 2.2.3)."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincc

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.network.pairs import Pair
from beltscape.calibration.network.pose_chains import (
    adjoint,
    compute_joint_covariance,
    find_pair_chain,
    list_triangles,
    log,
)
from beltscape.core.arrays import Array
from beltscape.core.geometry.pose import Pose

NEGLIGIBLE_VARIANCE = 1e-7
"""Share of the pairs' variance below which first-order propagation cannot distinguish a variance from 0."""


@dataclass(frozen=True, slots=True, eq=False)
class Misclosure:
    """A rigid motion that should be the identity, with its expected size from noise alone."""

    cameras: tuple[str, ...]
    """The pair of a path error, the triangle of a loop error."""
    rotation_deg: float
    translation_mm: float
    """Displacement of a camera centre."""
    twist: Array
    """(6,) logarithm of the motion, rad and mm, in the frame of the first camera."""
    covariance: Array
    """(6, 6) of the twist, from the corners' noise as each camera's own residuals show it."""
    chi2: float
    """Squared Mahalanobis length of the twist; NaN with 0 degrees of freedom."""
    dof: int
    """6; fewer where directions are free of error by construction."""

    @property
    def chi2_per_dof(self) -> float:
        """χ² per degree of freedom, about 1 if noise explains the misclosure; NaN without any."""
        return self.chi2 / self.dof if self.dof else float("nan")

    @property
    def p_value(self) -> float:
        """Probability of a misclosure at least this large from noise alone; NaN with 0 degrees of freedom."""
        return float(gammaincc(0.5 * self.dof, 0.5 * self.chi2)) if self.dof else float("nan")


class PathError(Misclosure):  # pyrefly: ignore[bad-class-definition]
    """ε_path: disagreement of a measured pair with the chain through the core (Eq. 16)."""

    __slots__ = ()

    @property
    def pair(self) -> tuple[str, ...]:
        """The two cameras."""
        return self.cameras


class LoopError(Misclosure):  # pyrefly: ignore[bad-class-definition]
    """ε_loop: misclosure of the three measured pairs of a triangle (Eq. 16)."""

    __slots__ = ()


@dataclass(frozen=True, slots=True, eq=False)
class CameraNetwork:
    """Poses of all cameras relative to the core, with the paths and misclosures of the network."""

    core: str
    cam_from_core: Mapping[str, Pose]
    paths: Mapping[str, tuple[str, ...]]
    """camera → the cameras from the core to it, both ends included."""
    pairs: tuple[Pair, ...]
    path_errors: tuple[PathError, ...]
    """For every pair except those that agree by construction, as the pairs of a path do."""
    loop_errors: tuple[LoopError, ...]
    """For every three cameras with three measured pairs; they do not depend on the poses."""
    initial: CameraNetwork | None = None
    """The network before global optimisation; None if it was not optimised."""


def find_groups(cameras: Iterable[str], pairs: Sequence[Pair]) -> list[tuple[str, ...]]:
    """Return the connected components of the cameras under shared views, the largest first."""
    remaining: list[str] = list(cameras)
    components: list[tuple[str, ...]] = []
    while remaining:
        reached = set(_find_paths(remaining[0], pairs)[0])
        components.append(tuple(name for name in remaining if name in reached))
        remaining = [name for name in remaining if name not in reached]
    return sorted(components, key=len, reverse=True)


def associate_cameras(core: str, pairs: Sequence[Pair]) -> CameraNetwork:
    """Compute the pose of every camera that is connected to the core, by the best path.

    The best path has the least summed variance of its pairs. It is the direct one if core and camera share enough
    views, otherwise it leads through other cameras (Eqs. 9-13).
    """
    kept = tuple(pairs)
    _, previous = _find_paths(core, kept)
    poses = _chain_poses(core, previous, kept)
    paths: dict[str, tuple[str, ...]] = {core: (core,)}
    jacobians = {core: np.zeros((6, 6 * len(kept)))}
    for name, before in previous.items():  # in the order they were reached: the path to `before` is known
        chain = find_pair_chain(kept, before, name)
        jacobians[name] = adjoint(chain.pose) @ (jacobians[before] + chain.jacobian)
        paths[name] = (*paths[before], name)
    joint = compute_joint_covariance(kept)
    return CameraNetwork(
        core,
        poses,
        paths,
        kept,
        compute_path_errors(kept, poses, jacobians, joint),
        compute_loop_errors(kept, poses, joint),
    )


def chain_cameras(core: str, pairs: Sequence[Pair]) -> CameraNetwork:
    """Compute the poses by the best paths as `associate_cameras` does, without misclosures: a start."""
    kept = tuple(pairs)
    _, previous = _find_paths(core, kept)
    paths: dict[str, tuple[str, ...]] = {core: (core,)}
    for name, before in previous.items():
        paths[name] = (*paths[before], name)
    return CameraNetwork(core, _chain_poses(core, previous, kept), paths, kept, (), ())


def _chain_poses(core: str, previous: Mapping[str, str], pairs: Sequence[Pair]) -> dict[str, Pose]:
    """Return cam_from_core along the paths from the core, given each camera's predecessor."""
    poses = {core: Pose.identity()}
    for name, before in previous.items():  # in the order they were reached: the pose of `before` is known
        poses[name] = find_pair_chain(pairs, before, name).pose @ poses[before]
    return poses


def select_core(detections: BoardDetections, pairs: Sequence[Pair]) -> str:
    """Return the most central camera among those that share the most views: the paper's best field of view.

    A camera is eligible if it shares at least 80 % of the corners that the best one shares with the others.
    """
    group = find_groups(detections.cameras, pairs)[0]
    shared = {name: sum(p.corners for p in pairs if name in (p.first, p.second)) for name in group}
    eligible = [name for name in group if shared[name] >= 0.8 * max(shared.values())]
    poses = _chain_poses(group[0], _find_paths(group[0], pairs)[1], pairs)
    centers = {name: pose.center_mm for name, pose in poses.items()}
    spread = {
        name: round(sum(float(np.linalg.norm(centers[name] - other)) for other in centers.values()), 3)
        for name in eligible
    }
    return min(eligible, key=lambda name: spread[name])


def _find_paths(core: str, pairs: Sequence[Pair]) -> tuple[dict[str, float], dict[str, str]]:
    """Return, by Dijkstra from the core, the cost of each camera and its predecessor, in the order reached."""
    costs: dict[str, float] = {}
    previous: dict[str, str] = {}
    queue = [(0.0, core, core)]
    while queue:
        cost, name, before = heapq.heappop(queue)
        if name in costs:
            continue
        costs[name] = cost
        if name != core:
            previous[name] = before
        for pair in pairs:
            if name in (pair.first, pair.second):
                other = pair.second if name == pair.first else pair.first
                heapq.heappush(queue, (cost + pair.variance, other, name))
    return costs, previous


def compute_path_errors(
    pairs: Sequence[Pair], cam_from_core: Mapping[str, Pose], jacobians: Mapping[str, Array], joint: Array
) -> tuple[PathError, ...]:
    """Return ε_path of every pair whose two cameras have a pose, except those that agree by construction.

    ``jacobians`` are derivatives of the poses by all pairs' errors: ``cam_from_core = exp(jacobian ξ) @ true``.
    """
    errors: list[PathError] = []
    for pair in pairs:
        if not {pair.first, pair.second} <= cam_from_core.keys():
            continue
        transmitted = cam_from_core[pair.second] @ cam_from_core[pair.first].inverse()  # T*_ij, Eqs. 11-13
        jacobian = find_pair_chain(pairs, pair.first, pair.second).jacobian + jacobians[pair.first]
        jacobian = jacobian - adjoint(transmitted.inverse()) @ jacobians[pair.second]
        error = transmitted.inverse() @ pair.second_from_first
        shift = float(np.linalg.norm(transmitted.center_mm - pair.second_from_first.center_mm))
        covariance = jacobian @ joint @ jacobian.T
        chi2, dof = _compute_chi2(log(error), covariance, pair.covariance)
        if dof:
            cameras = (pair.first, pair.second)
            errors.append(PathError(cameras, error.angle_deg, shift, log(error), covariance, chi2, dof))
    return tuple(errors)


def compute_loop_errors(pairs: Sequence[Pair], cameras: Iterable[str], joint: Array) -> tuple[LoopError, ...]:
    """Return ε_loop of every triangle, the composition of its three measured pairs."""
    errors: list[LoopError] = []
    for triangle in list_triangles(pairs, cameras):
        a, b, c = triangle
        loop = (
            find_pair_chain(pairs, a, b)
            .extend(find_pair_chain(pairs, b, c))
            .extend(find_pair_chain(pairs, c, a))
        )
        own = np.flatnonzero(loop.jacobian.any(axis=0))  # the columns of its three pairs
        jacobian, errors_of_pairs = loop.jacobian[:, own], joint[np.ix_(own, own)]
        is_same_pair = own[:, None] // 6 == own // 6  # pairs taken as independent
        twist, covariance = log(loop.pose), jacobian @ errors_of_pairs @ jacobian.T
        chi2, dof = _compute_chi2(twist, covariance, jacobian @ (errors_of_pairs * is_same_pair) @ jacobian.T)
        shift = float(np.linalg.norm(loop.pose.center_mm))
        errors.append(LoopError(triangle, loop.pose.angle_deg, shift, twist, covariance, chi2, dof))
    return tuple(errors)


def _compute_chi2(twist: Array, covariance: Array, unit: Array) -> tuple[float, int]:
    """Return χ² of a twist and its degrees of freedom; ``unit`` (6, 6) scales negligible variances."""
    root = np.linalg.cholesky(unit)
    variances, axes = np.linalg.eigh(np.linalg.solve(root, np.linalg.solve(root, covariance).T))
    significant = variances > NEGLIGIBLE_VARIANCE
    components = axes.T @ np.linalg.solve(root, twist)
    return float((components[significant] ** 2 / variances[significant]).sum()), int(significant.sum())
