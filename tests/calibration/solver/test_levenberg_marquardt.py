"""Levenberg–Marquardt: steps, limits and minima of simple problems."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from beltscape.calibration.solver.levenberg_marquardt import (
    Damping,
    LeastSquaresProblem,
    LinearisedProblem,
    minimise,
)

Vector = NDArray[np.float64]


class Curve(LeastSquaresProblem[Vector]):
    """Least squares of a model and its Jacobian, on a plain vector."""

    def __init__(self, errors: Callable[[Vector], Vector], jacobian: Callable[[Vector], Vector]):
        self.errors, self.jacobian = errors, jacobian
        self.costs: list[float] = []

    def compute_cost(self, state: Vector) -> float:
        return 0.5 * float((self.errors(state) ** 2).sum())

    def linearise(self, state: Vector) -> Linear:
        self.costs.append(self.compute_cost(state))
        return Linear(self.compute_cost(state), self.errors(state), self.jacobian(state))

    def apply_step(self, state: Vector, step: Vector) -> Vector:
        return state + step


class Linear(LinearisedProblem):
    def __init__(self, cost: float, errors: Vector, jacobian: Vector):
        self.cost, self.errors, self.jacobian = cost, errors, jacobian

    def solve_step(self, damping: float) -> Vector:
        normal = self.jacobian.T @ self.jacobian
        return -np.linalg.solve(
            normal + damping * np.diag(np.diag(normal)), self.jacobian.T @ self.errors
        ).astype(float)

    def predict_decrease(self, step: Vector) -> float:
        return self.cost - 0.5 * float(((self.errors + self.jacobian @ step) ** 2).sum())


def rosenbrock():
    return Curve(
        lambda x: np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]),
        lambda x: np.array([[-20 * x[0], 10.0], [-1.0, 0.0]]),
    )


def test_a_linear_problem_takes_one_step_and_a_check():
    curve = Curve(lambda x: np.array([x[0] - 3, 2 * x[1] + 4]), lambda _: np.diag([1.0, 2.0]))
    found = minimise(curve, np.zeros(2), Damping(start=1e-12))
    np.testing.assert_allclose(found.state, [3, -2], atol=1e-9)
    assert found.converged
    assert found.iterations <= 3


def test_the_minimum_of_a_curved_valley_is_reached():
    found = minimise(rosenbrock(), np.array([-1.2, 1.0]))
    np.testing.assert_allclose(found.state, [1, 1], atol=1e-6)
    assert found.converged


def test_every_accepted_step_lowers_the_cost():
    curve = rosenbrock()
    minimise(curve, np.array([-1.9, 2.0]))
    assert all(later < earlier for earlier, later in zip(curve.costs, curve.costs[1:], strict=False))


def test_the_iteration_limit_ends_the_minimisation():
    found = minimise(rosenbrock(), np.array([-1.2, 1.0]), Damping(iterations=2))
    assert not found.converged
    assert found.iterations == 2


@pytest.mark.parametrize("start", [1e-12, 1.0, 1e6])
def test_the_minimum_does_not_depend_on_the_first_damping(start):
    found = minimise(rosenbrock(), np.array([-1.2, 1.0]), Damping(start=start, iterations=500))
    np.testing.assert_allclose(found.state, [1, 1], atol=1e-5)
