"""Levenberg–Marquardt minimisation with damping controlled by the gain ratio (the paper's Eqs. 19-20)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

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


class Problem(Protocol[State]):
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


def minimise(problem: Problem[State], state: State, damping: Damping | None = None) -> Minimum[State]:
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
