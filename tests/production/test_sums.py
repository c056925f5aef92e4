"""Totals of any records have the σ of the meter that measured them."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce

import numpy as np
import pytest

from beltscape.core.ledger import BeltRecord, FlowRecord
from beltscape.measure.flow.profile import Stretch
from beltscape.measure.flow.strips import StripSums
from beltscape.production.sums import ProductionSums, sum_record

DENSITY = (1600.0, 80.0)


def measure(
    count: int, seed: int, density: tuple[float, float] = DENSITY
) -> tuple[StripSums, list[BeltRecord]]:
    """Return the meter's sums of random strips, and their records."""
    rng, sums, records = np.random.default_rng(seed), StripSums(0.2, 800.0), list[BeltRecord]()
    for number in range(1, count + 1):
        volume = rng.uniform(1e6, 9e6)
        stretch = Stretch(100.0, volume, 100.0, 0.0, 0.9, 0.7, rng.uniform(1e8, 4e8), 900.0, 2000.0)
        moved, fault = 4000.0, 0.003 * volume
        begin = (100.0 * (number - 1), 100.0 * number)
        parts = sums.compute_parts(stretch, moved, fault, 3)
        sums.add(begin, stretch, parts, density)
        strip = FlowRecord(
            f"{number}", None, 0.0, begin, volume / 100, volume, parts.sigma_mm3,
            500.0, density[0], 0.9, 0.7, "measured", "", parts.common_sigma_mm3, density[1],
        )  # fmt: skip
        records.append(BeltRecord(number, 1, begin, "valid", "", 0, strip, 0.0, 5, None))
    return sums, records


def add_up(records: list[BeltRecord]) -> ProductionSums:
    return reduce(ProductionSums.__add__, map(sum_record, records), ProductionSums())


@pytest.mark.parametrize("count", [1, 7, 400])
def test_the_sums_of_all_strips_are_the_meters(count: int) -> None:
    meter, records = measure(count, seed=3)
    ours, expected = add_up(records), meter.totals
    assert ours.volume_mm3 == pytest.approx(expected.volume_mm3, rel=1e-12)
    assert ours.mass_kg == pytest.approx(expected.mass_kg, rel=1e-12)
    # never below the meter's, and above it only as far as the kinds of common errors change their shares
    assert expected.sigma_mm3 * (1 - 1e-12) <= ours.sigma_mm3 <= 1.05 * expected.sigma_mm3
    assert ours.mass_sigma_kg == pytest.approx(expected.mass_sigma_kg, rel=0.02)


def test_a_common_error_does_not_average_out() -> None:
    _, few = measure(10, seed=5)
    _, many = measure(1000, seed=5)
    relative = [add_up(each).sigma_mm3 / add_up(each).volume_mm3 for each in (few, many)]
    assert relative[1] > 0.8 * relative[0]
    independent = [
        replace(r, strip=replace(r.strip, common_sigma_mm3=0.0)) for r in many if r.strip is not None
    ]
    assert add_up(independent).sigma_mm3 < 0.3 * add_up(many).sigma_mm3


def test_sums_of_parts_are_the_sums_of_the_whole() -> None:
    _, records = measure(50, seed=7)
    parts = add_up(records[:20]) + add_up(records[20:])
    assert parts.sigma_mm3 == pytest.approx(add_up(records).sigma_mm3, rel=1e-12)
    assert parts.valid_mm == pytest.approx(5000.0)


def test_a_strip_whose_common_part_is_not_known_is_common() -> None:
    _, records = measure(9, seed=1)
    old = [replace(r, strip=replace(r.strip, common_sigma_mm3=float("nan"))) for r in records if r.strip]
    assert add_up(old).sigma_mm3 == pytest.approx(sum(r.sigma_mm3 for r in records), rel=1e-12)


def test_missing_belt_is_in_no_total() -> None:
    _, (record,) = measure(1, seed=1)
    sums = add_up([replace(record, standing="missing"), replace(record, strip=None, standing="missing")])
    assert (sums.volume_mm3, sums.sigma_mm3, sums.missing_mm, sums.records) == (0.0, 0.0, 200.0, 2)
    assert sums.mass_kg == 0.0


def test_a_load_without_density_has_no_mass() -> None:
    _, records = measure(3, seed=1)
    unknown = replace(records[0], strip=replace(records[0].strip, density_kg_m3=float("nan")))  # pyrefly: ignore[bad-specialization]
    sums = add_up([*records, unknown])
    assert np.isnan(sums.mass_kg)
    assert np.isnan(sums.mass_sigma_kg)
    assert np.isfinite(sums.sigma_mm3)


@pytest.mark.parametrize("part", [slice(0, 5), slice(100, 160), slice(0, 300)])
def test_errors_of_truth_lie_within_the_sigma(part: slice) -> None:
    """Of errors drawn 2000 times, common and independent, z of a part's total has a spread of 0.8 to 1.05."""
    rng, count = np.random.default_rng(9), 300
    own, edges, drift = rng.uniform(2e4, 6e4, count), rng.uniform(1e3, 3e3, count), np.full(count, 2e4)
    common = np.hypot(edges, drift)
    strips = [
        FlowRecord(
            f"{k}", None, 0.0, (0.0, 1.0), 1.0, 5e6, float(np.hypot(own[k], common[k])), 1.0, 1000.0, 1.0, 1.0,
            "measured", "", float(common[k]), 0.0,
        )
        for k in range(count)
    ]  # fmt: skip
    sums = add_up(
        [
            BeltRecord(k, 1, (0.0, 1.0), "valid", "", 0, one, 0.0, 5, None)
            for k, one in enumerate(strips[part])
        ]
    )
    errors = rng.normal(size=(2000, count)) * own + rng.normal(size=(2000, 2)) @ np.stack([edges, drift])
    z = errors[:, part].sum(axis=1) / sums.sigma_mm3
    assert 0.8 < z.std() < 1.05
