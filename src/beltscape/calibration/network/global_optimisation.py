"""Global optimisation of the camera network: the paper's Section 2.2.4."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from beltscape.calibration.network.association import CameraNetwork, compute_path_errors
from beltscape.calibration.network.pose_chains import (
    PoseChain,
    adjoint,
    compute_joint_covariance,
    exp,
    find_pair_chain,
    left_jacobian_inverse,
    list_triangles,
    log,
)
from beltscape.calibration.solver.levenberg_marquardt import Damping, minimise
from beltscape.core.arrays import Array
from beltscape.core.geometry.pose import Pose

Poses = Mapping[str, Pose]


@dataclass(frozen=True, slots=True)
class NetworkWeights:
    """λ1 and λ2 of Eq. 18; loops repeat the information of paths: in simulation λ2 = 1 costs 2 % of accuracy."""

    path: float = 1.0
    loop: float = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Constraint:
    """A measured chain between two cameras that constrains the transmitted pose T*_ij = T_kj T_ki⁻¹."""

    first: str
    second: str
    chain: PoseChain
    root: Array
    """(6, 6) √λ Σ^-½, the whitening of the residual."""

    def compute_residual(self, cam_from_core: Poses) -> Array:
        """Return the residual (6,) √λ Σ^-½ log(T*⁻¹ T), unitless."""
        transmitted = cam_from_core[self.second] @ cam_from_core[self.first].inverse()
        return self.root @ log(transmitted.inverse() @ self.chain.pose)

    def linearise(self, cam_from_core: Poses) -> tuple[Array, Array, Array]:
        """Return the residual (6,), and its derivatives (6, 6) by δ of either camera in ``exp(δ) @ cam_from_core``.

        T* becomes exp(δ_j) T* exp(−δ_i), hence T*⁻¹ T becomes exp(δ_i) exp(−Ad(T*⁻¹) δ_j) T*⁻¹ T.
        """
        inverse = cam_from_core[self.first] @ cam_from_core[self.second].inverse()
        twist = log(inverse @ self.chain.pose)
        by_first = self.root @ left_jacobian_inverse(twist)
        return self.root @ twist, by_first, -by_first @ adjoint(inverse)


class NetworkProblem:
    """Eq. 18 as a problem for `levenberg_marquardt.minimise`; the state is ``cam_from_core``, the paper's T_ki⁻¹."""

    def __init__(self, core: str, cameras: Sequence[str], constraints: Sequence[Constraint]) -> None:
        auxiliaries = [name for name in cameras if name != core]
        self.columns = {name: slice(6 * i, 6 * i + 6) for i, name in enumerate(auxiliaries)}
        self.constraints = constraints

    def compute_cost(self, state: Poses) -> float:
        """Return F, half of λ1 Σ ε_path² + λ2 Σ ε_loop²."""
        return 0.5 * float(
            sum((constraint.compute_residual(state) ** 2).sum() for constraint in self.constraints)
        )

    def linearise(self, state: Poses) -> LinearisedNetwork:
        """Return the residuals and their analytic derivatives at a state."""
        residual = np.empty(6 * len(self.constraints))
        jacobian = np.zeros((len(residual), 6 * len(self.columns)))
        for i, constraint in enumerate(self.constraints):
            rows = slice(6 * i, 6 * i + 6)
            residual[rows], *by_poses = constraint.linearise(state)
            for name, by_pose in zip((constraint.first, constraint.second), by_poses, strict=True):
                if name in self.columns:  # the core is fixed
                    jacobian[rows, self.columns[name]] = by_pose
        return LinearisedNetwork(residual, jacobian)

    def apply_step(self, state: Poses, step: Array) -> Poses:
        """Return the poses with every auxiliary's perturbed on its left."""
        perturbed = {name: exp(step[columns]) @ state[name] for name, columns in self.columns.items()}
        return {name: perturbed.get(name, pose) for name, pose in state.items()}

    def compute_pose_jacobians(self, state: Poses) -> dict[str, Array]:
        """Return by camera the derivatives (6, 6P) of the minimum by the errors of all pairs, 0 for the core."""
        linear = self.linearise(state)
        orthonormal, triangle = np.linalg.qr(linear.jacobian)
        by_pairs = np.zeros((len(triangle), self.constraints[0].chain.jacobian.shape[1]))
        for constraint, rows in zip(self.constraints, orthonormal.reshape(-1, 6, len(triangle)), strict=True):
            own = np.flatnonzero(constraint.chain.jacobian.any(axis=0))  # the columns of its pairs
            by_pairs[:, own] += rows.T @ constraint.root @ constraint.chain.jacobian[:, own]
        jacobian = -solve_triangular(triangle, by_pairs)
        fixed = np.zeros((6, by_pairs.shape[1]))
        return {name: jacobian[self.columns[name]] if name in self.columns else fixed for name in state}


class LinearisedNetwork:
    """The normal equations of the network at a state."""

    def __init__(self, residual: Array, jacobian: Array) -> None:
        self.cost = 0.5 * float(residual @ residual)
        self.jacobian = jacobian
        self._hessian = jacobian.T @ jacobian
        self._gradient = jacobian.T @ residual

    def solve_step(self, damping: float) -> Array:
        """Return the damped step of Eq. 19 with Marquardt's scaling."""
        damped = self._hessian + damping * np.diag(np.diag(self._hessian))
        return cho_solve(cho_factor(damped), -self._gradient)

    def predict_decrease(self, step: Array) -> float:
        """Return F(X) − L(X + δ)."""
        return -float(self._gradient @ step + 0.5 * step @ self._hessian @ step)


def optimise_network(
    network: CameraNetwork, weights: NetworkWeights | None = None, damping: Damping | None = None
) -> CameraNetwork:
    """Estimate the poses from all measured pairs jointly, instead of one path for each camera (Eqs. 17-20).

    The unknowns are the poses of all cameras but the core (Eq. 17). ε_path of a pair, core pairs included, is the
    logarithm of the difference between the measured and the transmitted pose; ε_loop is the same for two successive
    measured pairs of a triangle, which the transmitted third side closes. Each is weighted by its own covariance.
    The result keeps the given network as ``initial``. Without redundancy, as with two cameras, no pose changes.
    """
    constraints = _make_constraints(network, weights or NetworkWeights())
    if len(network.pairs) < len(network.cam_from_core):  # a tree: nothing to optimise
        return replace(network, initial=network)
    problem = NetworkProblem(network.core, tuple(network.cam_from_core), constraints)
    poses = minimise(problem, network.cam_from_core, damping).state
    pairs, joint = network.pairs, compute_joint_covariance(network.pairs)
    return replace(
        network,
        cam_from_core=poses,
        path_errors=compute_path_errors(pairs, poses, problem.compute_pose_jacobians(poses), joint),
        initial=network,
    )


def _make_constraints(network: CameraNetwork, weights: NetworkWeights) -> list[Constraint]:
    """Return the constraints of nonzero weight, paths first, then loops."""
    pairs, known = network.pairs, network.cam_from_core

    def constraint(first: str, second: str, chain: PoseChain, weight: float) -> Constraint:
        by_pair = chain.jacobian.reshape(6, -1, 6).swapaxes(0, 1)
        # the weights take the pairs as independent: their common errors do not show which pair is wrong
        own = np.flatnonzero(by_pair.any(axis=(1, 2)))
        covariance = sum(by_pair[i] @ pairs[i].covariance @ by_pair[i].T for i in own)
        root = np.linalg.cholesky(covariance / weight)
        return Constraint(first, second, chain, np.asarray(np.linalg.inv(root), np.float64))

    constraints: list[Constraint] = []
    if weights.path > 0:
        constraints += [
            constraint(p.first, p.second, find_pair_chain(pairs, p.first, p.second), weights.path)
            for p in pairs
            if {p.first, p.second} <= known.keys()
        ]
    if weights.loop > 0:
        for three in list_triangles(pairs, known):
            for a, b, c in (three, three[1:] + three[:1], three[2:] + three[:2]):
                chain = find_pair_chain(pairs, a, b).extend(find_pair_chain(pairs, b, c))
                constraints.append(constraint(a, c, chain, weights.loop))
    return constraints
