"""Budgets against worked examples of the GUM."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beltscape.metrology.uncertainty import (
    Contribution,
    Effect,
    build_covariance,
    combine_effects,
    compute_coverage_factor,
    make_budget,
    solve_linear,
)


def test_the_example_of_effective_degrees_of_freedom_in_the_gum() -> None:
    """GUM G.4.1: relative σ of 0.25, 0.57 and 0.82 % from 10, 5 and 15 readings; 1.03 %, 19.0, U95 = 2.2 %."""
    parts = [
        Contribution("x1", "A", 0.25, 9), Contribution("x2", "A", 0.57, 4), Contribution("x3", "A", 0.82, 14)
    ]  # fmt: skip
    budget = make_budget(parts, 0.95)
    assert budget.sigma == pytest.approx(1.03, abs=0.005)
    assert budget.degrees_of_freedom == pytest.approx(19.0, abs=0.05)
    assert budget.coverage_factor == pytest.approx(2.09, abs=0.005)
    assert budget.expanded == pytest.approx(2.2, abs=0.05)
    assert [one.key for one in budget.contributions] == ["x3", "x2", "x1"]


@pytest.mark.parametrize(
    ("degrees", "confidence", "factor"),
    [(1, 0.95, 12.71), (5, 0.95, 2.57), (10, 0.6827, 1.05), (19, 0.9545, 2.14), (math.inf, 0.95, 1.96)],
)
def test_the_table_of_student_s_distribution_in_the_gum(degrees, confidence, factor) -> None:
    """GUM table G.2."""
    assert compute_coverage_factor(degrees, confidence) == pytest.approx(factor, abs=0.005)


def test_a_common_effect_adds_linearly_and_independent_ones_in_squares() -> None:
    """GUM 5.2.2, example: ten resistors calibrated by one standard: Σ u(R) = 10 · 0.1 Ω, not √10 · 0.1 Ω."""
    ten = [f"r{n}" for n in range(10)]
    common = Effect("standard", "B", 0.1, sensitivity=dict.fromkeys(ten, 1.0))
    weights = dict.fromkeys(ten, 1.0)
    assert combine_effects([common], weights, 0.95).sigma == pytest.approx(1.0)
    apart = [Effect(name, "B", 0.1, sensitivity={name: 1.0}) for name in ten]
    assert combine_effects(apart, weights, 0.95).sigma == pytest.approx(0.1 * math.sqrt(10))
    difference = combine_effects([common], {"r0": 1.0, "r1": -1.0}, 0.95)
    assert difference.sigma == 0
    assert difference.contributions == ()


def test_a_combination_that_is_not_determined_is_known_as_such() -> None:
    """x + y = 3 alone determines neither x nor y; with x = 1 it determines both."""
    estimate = solve_linear(np.array([[1.0, 1.0]]), np.array([3.0]), np.eye(1))
    assert estimate.is_determined([1, 1])
    assert not estimate.is_determined([1, 0])
    both = solve_linear(np.array([[1.0, 1.0], [1.0, 0.0]]), np.array([3.0, 1.0]), np.diag([1.0, 1e-12]))
    assert both.values == pytest.approx([1, 2])
    assert both.is_determined([1, 0])
    assert both.redundancy == 0
    assert math.isnan(both.chi_square)


def test_redundant_observations_are_weighted_by_their_covariance() -> None:
    """Two correlated readings of one quantity: weights (σ₂² - c) and (σ₁² - c), by hand."""
    effects = [
        Effect("own1", "B", 1.0, sensitivity={"a": 1.0}),
        Effect("own2", "B", 2.0, sensitivity={"b": 1.0}),
        Effect("common", "B", 3.0, sensitivity={"a": 1.0, "b": 1.0}),
    ]
    covariance = build_covariance(effects, ["a", "b"])
    assert covariance == pytest.approx(np.array([[10.0, 9.0], [9.0, 13.0]]))
    estimate = solve_linear(np.array([[1.0], [1.0]]), np.array([5.0, 10.0]), covariance)
    assert estimate.weights[0] == pytest.approx([0.8, 0.2])  # (13 - 9) and (10 - 9), over 5
    assert estimate.values[0] == pytest.approx(6.0)
    sigma = combine_effects(effects, dict(zip(["a", "b"], estimate.weights[0], strict=True)), 0.95).sigma
    assert sigma == pytest.approx(math.sqrt(0.64 + 0.16 + 9))
    assert estimate.chi_square == pytest.approx(
        25 / 5
    )  # (10 - 5)² over the variance of the difference, 1 + 4
