"""The budget of the paid tonne: what is common adds linearly, what is not in squares; against Monte Carlo."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from beltscape.metrology.annual import CommonErrors, ProductPart, compute_paid_tonne

COAL = ProductPart("coal", 0, 1000.0, 800.0, 16.0, 0.5, 2.0, 3.0, 4.0, 1.0, missing_share=0.01)
ORE = ProductPart("ore", 1, 500.0, 2400.0, 24.0, 0.5, 1.0, 1.0, 2.0, 0.0)
ERRORS = CommonErrors(0.6, 0.004, 0.002, 0.003, {"coal": 0.1, "ore": 0.05})


def test_every_part_by_hand() -> None:
    found = compute_paid_tonne([COAL, ORE], ERRORS)
    assert found.unit == "t"
    assert found.amount == pytest.approx(800 + 1200)
    parts = {one.key: one.sigma for one in found.budget.contributions}
    assert parts == pytest.approx(
        {
            "edges": 2 * 0.8 + 1 * 2.4,
            "holes": 3 * 0.8 + 1 * 2.4,
            "faults": 0.8,
            "geometry": 0.8 * (4 * 0.8 + 2 * 2.4),
            "scale": 0.004 * 2000,
            "speed": 0.002 * 2000,
            "missing": 2 / math.sqrt(12) * 0.01 / 0.99 * 800,
            "matching": math.hypot(0.5 * 0.8, 0.5 * 2.4),
            "zero": 0.6 * math.hypot(4 * 0.8, 2 * 2.4),  # two settings of the zero
            "density": math.hypot(1000 * 0.016, 500 * 0.024),  # two products
            "moisture": math.hypot(800 * 0.003 / 0.9, 1200 * 0.003 / 0.95),
        }
    )
    assert found.budget.sigma == pytest.approx(math.sqrt(sum(part**2 for part in parts.values())))
    assert found.budget.coverage_factor == pytest.approx(1.96, abs=0.001)
    assert found.largest == "density"
    assert found.by_product == (("coal", pytest.approx(800)), ("ore", pytest.approx(1200)))


def test_the_scale_is_that_of_the_material_test_else_of_the_board() -> None:
    sized = [replace(COAL, scale_m3=3.0), replace(ORE, scale_m3=1.5)]
    untested = replace(ERRORS, scale_share=0.0)
    assert find_scale(sized, ERRORS) == pytest.approx(0.004 * 2000)
    assert find_scale(sized, untested) == pytest.approx(3 * 0.8 + 1.5 * 2.4)
    assert find_scale([COAL, ORE], untested) is None
    cancelling = [replace(one, is_tested=True) for one in sized]
    assert find_scale(cancelling, untested) is None


def find_scale(parts: list[ProductPart], errors: CommonErrors) -> float | None:
    budget = compute_paid_tonne(parts, errors).budget
    return next((one.sigma for one in budget.contributions if one.key == "scale"), None)


def test_a_year_averages_matching_out_and_nothing_that_is_common() -> None:
    once = compute_paid_tonne([COAL], ERRORS)
    often = compute_paid_tonne([COAL] * 100, ERRORS)
    one, many = ({part.key: part.sigma for part in found.budget.contributions} for found in (once, often))
    ratio = {key: many[key] / one[key] for key in one}
    assert ratio.pop("matching") == pytest.approx(10)
    assert all(value == pytest.approx(100) for value in ratio.values())


def test_without_a_density_the_budget_is_of_the_volume() -> None:
    bare = ProductPart("", 0, 1000.0, math.nan, 0.0, 0.5, 2.0)
    found = compute_paid_tonne([bare, COAL], ERRORS)
    assert (found.unit, found.amount) == ("m³", 2000.0)
    assert {one.key for one in found.budget.contributions}.isdisjoint({"density", "moisture"})


def test_sigma_agrees_with_a_monte_carlo() -> None:
    rng, draws = np.random.default_rng(6), 400_000
    z = {
        name: rng.standard_normal(draws)
        for name in ("edges", "holes", "geometry", "faults", "scale", "speed")
    }
    total = np.zeros(draws)
    for one in (COAL, ORE):
        volume = one.volume_m3 + one.matching_m3 * rng.standard_normal(draws)
        volume += one.edges_m3 * z["edges"] + one.holes_m3 * z["holes"] + one.faults_m3 * z["faults"]
        volume += one.drift_m3 * (0.8 * z["geometry"] + 0.6 * rng.standard_normal(draws))
        density = one.density_kg_m3 + one.density_sigma_kg_m3 * rng.standard_normal(draws)
        wet = 1 - ERRORS.moistures[one.product] - 0.003 * rng.standard_normal(draws)
        mass = volume * density * 1e-3 * (1 + 0.004 * z["scale"]) * (1 + 0.002 * z["speed"])
        unmeasured = rng.uniform(0, 2, draws) * one.missing_share / (1 - one.missing_share)
        total += mass * wet / (1 - ERRORS.moistures[one.product]) * (1 + unmeasured)
    found = compute_paid_tonne([COAL, ORE], ERRORS)
    assert found.budget.sigma == pytest.approx(total.std(), rel=0.01)
