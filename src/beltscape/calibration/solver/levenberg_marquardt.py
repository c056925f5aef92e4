"""Levenberg–Marquardt minimisation with damping controlled by the gain ratio (the paper's Eqs. 19-20).

Normal equations with one pose per frame are solved by eliminating these poses (Schur complement). OpenCV and BLAS are
restricted to one thread, for the same digits on any number of cores.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from threadpoolctl import threadpool_limits

from beltscape.core.arrays import Array

State = TypeVar("State")


class LinearisedProblem(Protocol):
    """A problem linearised at a state."""

    cost: float
    """F at that state: half the weighted sum of squares."""

    def solve_step(self, damping: float) -> NDArray[np.float64]:
        """Solve (JᵀJ + λ diag(JᵀJ)) δ = −Jᵀe (Eq. 19, Marquardt's scaling)."""
        ...

    def predict_decrease(self, step: NDArray[np.float64]) -> float:
        """Return F(X) − L(X + δ), the decrease of F that the linear model predicts."""
        ...


class LeastSquaresProblem(Protocol[State]):
    """A least-squares problem over a state, which need not be a vector space."""

    def compute_cost(self, state: State) -> float:
        """Return F at a state."""
        ...

    def linearise(self, state: State) -> LinearisedProblem:
        """Return the problem linearised at a state."""
        ...

    def apply_step(self, state: State, step: NDArray[np.float64]) -> State:
        """Return the state after a step."""
        ...


ROUNDING = 1e-26
"""Share of the first F below which F is rounding error: residuals of exact data do not fall to zero."""


@dataclass(frozen=True, slots=True)
class Damping:
    """Rules by which λ follows the gain ratio ρ = [F(X) − F(X + δ)] / [F(X) − L(X + δ)] (Eq. 20)."""

    start: float = 1e-4
    high: float = 0.75
    """η_h: λ falls above it, where the linear model is accurate."""
    low: float = 0.25
    """η_l: below it λ rises."""
    fall: float = 5.0
    rise: float = 4.0
    tolerance: float = 1e-9
    """The minimisation stops when a step is predicted to lower F, or lowers it, by less than this share."""
    iterations: int = 60


@dataclass(frozen=True, slots=True, eq=False)
class Minimum(Generic[State]):
    """Result of a minimisation."""

    state: State
    cost: float
    iterations: int
    converged: bool


def minimise(
    problem: LeastSquaresProblem[State], state: State, damping: Damping | None = None
) -> Minimum[State]:
    """Minimise F, starting at ``state``; every accepted step lowers F.

    References
    ----------
    Hou, Kang & Qiao, Sensors 2025, 25(7), 2111, doi:10.3390/s25072111, Eqs. 19-20; Madsen, Nielsen & Tingleff,
    Methods for Non-Linear Least Squares Problems, 2004.
    """
    rule = damping or Damping()
    lam = rule.start
    linear = problem.linearise(state)
    negligible = ROUNDING * linear.cost
    for iteration in range(1, rule.iterations + 1):
        step = linear.solve_step(lam)
        predicted = linear.predict_decrease(step)
        if not predicted > max(rule.tolerance * linear.cost, negligible):
            return Minimum(state, linear.cost, iteration, converged=True)
        candidate = problem.apply_step(state, step)
        cost = problem.compute_cost(candidate)
        gain = (linear.cost - cost) / predicted if np.isfinite(cost) else -np.inf
        if gain > rule.high:
            lam = max(lam / rule.fall, 1e-12)
        elif gain < rule.low:
            lam *= rule.rise
        if gain > 0:
            if linear.cost - cost < rule.tolerance * linear.cost:
                return Minimum(candidate, cost, iteration, converged=True)
            state, linear = candidate, problem.linearise(candidate)
        elif lam > 1e12:
            return Minimum(state, linear.cost, iteration, converged=True)
    return Minimum(state, linear.cost, rule.iterations, converged=False)


class LinearisedBundle:
    """Normal equations of a bundle adjustment: dense in the shared parameters, one 6×6 block per board pose."""

    def __init__(
        self,
        cost: float,
        hessian: Array,
        gradient: Array,
        blocks: Array,
        coupling: Array,
        block_gradient: Array,
    ) -> None:
        """Store ``hessian`` (G, G), ``blocks`` (F, 6, 6), ``coupling`` (G, 6F), gradients (G,) and (6F,)."""
        self.cost = cost
        self._hessian, self._gradient = hessian, gradient
        self._blocks, self._coupling, self._block_gradient = blocks, coupling, block_gradient

    def solve_step(self, damping: float) -> Array:
        """Return the damped step, solved by the Schur complement on the shared parameters."""
        reduced, right, inverse = self._reduce(damping)
        shared = -cho_solve(cho_factor(reduced), right)
        boards = self._block_gradient + self._coupling.T @ shared
        return np.concatenate([shared, -(inverse @ boards.reshape(-1, 6, 1)).ravel()])

    def _reduce(self, damping: float) -> tuple[Array, Array, Array]:
        """Return the Schur complement (G, G), its right side (G,) and the inverse board blocks (F, 6, 6)."""
        diagonal = np.einsum("fii->fi", self._blocks)
        unobserved = diagonal == 0  # the pose of a frame without weighted corners stays unchanged
        scaled = self._blocks + (damping * diagonal + unobserved)[:, :, None] * np.eye(6)
        inverse = np.asarray(np.linalg.inv(scaled), np.float64)
        by_board = self._coupling.reshape(len(self._gradient), len(self._blocks), 6).swapaxes(0, 1)
        eliminated = np.matmul(by_board, inverse).swapaxes(0, 1).reshape(self._coupling.shape)
        reduced = self._hessian - eliminated @ self._coupling.T
        reduced[np.diag_indices_from(reduced)] += damping * np.diag(self._hessian)
        return reduced, self._gradient - eliminated @ self._block_gradient, inverse

    def invert_boards(self) -> tuple[Array, Array]:
        """Return the covariances (F, 6, 6) of the board poses at fixed shared parameters, and their responses.

        A board's response (6, G) is minus the derivative of its pose by the shared parameters.
        """
        _, _, inverse = self._reduce(0.0)
        by_board = self._coupling.reshape(len(self._gradient), len(self._blocks), 6)
        return inverse, np.einsum("fij,gfj->fig", inverse, by_board)

    def predict_decrease(self, step: Array) -> float:
        """Return F(X) − L(X + δ)."""
        count = len(self._gradient)
        shared, boards = step[:count], step[count:]
        by_board = boards.reshape(-1, 6, 1)
        change = self._gradient @ shared + 0.5 * shared @ self._hessian @ shared
        change += self._block_gradient @ boards + 0.5 * float((by_board * (self._blocks @ by_board)).sum())
        return -float(change + shared @ self._coupling @ boards)

    def covariance(self, damping: float = 0.0) -> Array:
        """Return the covariance of the free shared parameters, the inverse of the Schur complement."""
        reduced, _, _ = self._reduce(damping)
        return cho_solve(cho_factor(reduced), np.eye(len(reduced)))


@contextmanager
def single_thread() -> Generator[None]:
    """Run OpenCV and BLAS on one thread: the last digits of parallel sums depend on the number of threads.

    The matrices are small, so one thread is also the fastest.
    """
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with threadpool_limits(limits=1, user_api="blas"):
            yield
    finally:
        cv2.setNumThreads(before)
