"""A belt scale's counter against our volume: density, moisture, trend, and who disagrees."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from beltscape.production.scale import ScaleReading, Weighing, compare, fit_trend, weigh
from beltscape.production.settings import ProductSettings, ScaleSettings
from beltscape.production.sums import ProductionSums

SETTINGS = ScaleSettings(sigma_percent=0.5, resolution_kg=1.0)
COAL = ProductSettings(name="coal", density_kg_m3=800, sigma_kg_m3=16, moisture_percent=10)
S_NS = 10**9


def readings(*pairs: tuple[float, float]) -> Sequence[ScaleReading]:
    return [ScaleReading(round(second * S_NS), kg, "csv") for second, kg in pairs]


def make_sums(volume_m3: float, density: float = 800.0, missing: float = 0.0) -> ProductionSums:
    return ProductionSums(
        records=10,
        volume_mm3=volume_m3 * 1e9,
        common_mm3=volume_m3 * 1e9 * 0.004,
        weighed_kg=volume_m3 * density,
        mass_common_kg=volume_m3 * density * 0.004,
        density_common_kg=volume_m3 * 16,
        valid_mm=1000 * (1 - missing),
        missing_mm=1000 * missing,
    )


def test_a_counter_is_interpolated_with_its_uncertainty() -> None:
    found = weigh(
        readings((0, 1000), (10, 1000), (110, 51_000), (120, 51_000)), 5 * S_NS, 115 * S_NS, SETTINGS
    )
    assert found.kg == pytest.approx(50_000)
    assert found.sigma_kg == pytest.approx(250, rel=1e-3)
    between = weigh(readings((0, 0), (100, 1000)), 25 * S_NS, 75 * S_NS, SETTINGS)
    assert between.kg == pytest.approx(500)
    assert between.sigma_kg == pytest.approx(1000 * math.sqrt(2 / 12), rel=0.01)


@pytest.mark.parametrize("times", [(10, 100), (0, 50)])
def test_a_period_beyond_the_readings_is_not_weighed(times: tuple[int, int]) -> None:
    found = weigh(readings((5, 0), (60, 100)), times[0] * S_NS - 6 * S_NS, times[1] * S_NS, SETTINGS)
    assert math.isnan(found.kg)
    assert found.reason


def test_a_counter_that_rolls_over_goes_on_and_one_that_is_reset_does_not() -> None:
    counted = readings((0, 990_000), (10, 999_000), (20, 4000))
    rolling = SETTINGS.model_copy(update={"rolls_over_kg": 1_000_000.0})
    assert weigh(counted, 0, 20 * S_NS, rolling).kg == pytest.approx(14_000)
    assert "reset" in weigh(counted, 0, 20 * S_NS, SETTINGS).reason
    assert weigh(counted, 0, 10 * S_NS, SETTINGS).kg == pytest.approx(9000)  # before the reset


def test_density_and_moisture_are_found() -> None:
    found = compare(Weighing(84_000, 420), make_sums(100), COAL)
    assert found.density_kg_m3 == pytest.approx(840)
    assert found.sigma_kg_m3 == pytest.approx(840 * math.hypot(0.005, 0.004), rel=1e-6)
    assert found.moisture_percent == pytest.approx(100 * (1 - 720 / 840))
    assert found.deviation_kg == pytest.approx(4000)
    assert not found.disagrees  # 4000 kg at σ 1.7 t


def test_a_scale_that_disagrees_beyond_its_sigma_is_reported() -> None:
    assert compare(Weighing(90_000, 450), make_sums(100), COAL).disagrees
    unknown = compare(
        Weighing(90_000, 450), ProductionSums(1, 1e11, 0.0, 1e8, unweighed=1, valid_mm=1.0), None
    )
    assert not unknown.disagrees
    assert unknown.density_kg_m3 == pytest.approx(900)


def test_sound_scales_are_seldom_accused() -> None:
    rng, accused = np.random.default_rng(11), 0
    for _ in range(2000):
        truth, density = rng.uniform(20, 500), rng.normal(800, 16)
        scale = Weighing(truth * density * (1 + rng.normal(0, 0.005)), truth * density * 0.005)
        accused += compare(scale, make_sums(truth * (1 + rng.normal(0, 0.004))), COAL).disagrees
    assert accused <= 16  # 5.4 expected at 3 σ


def test_missing_belt_widens_and_too_much_of_it_ends_the_comparison() -> None:
    few = compare(Weighing(80_000, 400), make_sums(90, missing=0.1), COAL)
    assert few.density_kg_m3 == pytest.approx(800)
    assert few.sigma_kg_m3 > 0.06 * 800
    assert compare(Weighing(80_000, 400), make_sums(50, missing=0.5), COAL).reason
    assert compare(Weighing(80_000, 400), ProductionSums(), COAL).reason


def test_a_trend_is_found_with_its_uncertainty() -> None:
    rng, days = np.random.default_rng(2), 86_400 * S_NS
    found = fit_trend([(k * days, 800 + 2.0 * k + rng.normal(0, 3)) for k in range(40)])
    assert found is not None
    assert abs(found.per_day_kg_m3 - 2.0) < 4 * found.sigma_per_day_kg_m3
    assert found.sigma_per_day_kg_m3 == pytest.approx(3 / math.sqrt(40**3 / 12), rel=0.5)
    assert fit_trend([(0, 800.0)]) is None
    two = fit_trend([(0, 800.0), (days, 810.0)])
    assert two is not None
    assert math.isnan(two.sigma_per_day_kg_m3)


def test_two_sources_are_refused() -> None:
    with pytest.raises(ValueError, match="one way"):
        ScaleSettings.model_validate({"csv": "a.csv", "modbus": {"host": "x", "address": 1}})
