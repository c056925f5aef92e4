"""Series of the history: sums, means and missing values."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.optional import require
from tests.sinks.ledgers import START_NS, ledger

HOUR_NS = 3_600_000_000_000
SETTINGS = HistorySettings(reserve_mib=1)
FIRST_NS = START_NS // HOUR_NS * HOUR_NS


@pytest.fixture(scope="module")
def records():
    """Three hours, one every ten seconds."""
    return ledger(1080, start_ns=FIRST_NS, every_ns=10_000_000_000, sections=False)


@pytest.fixture(scope="module")
def historian(tmp_path_factory, records):
    """A history that the tests only read."""
    one = Historian(tmp_path_factory.mktemp("series"), SETTINGS)
    one.write(records)
    yield one
    one.close()


@pytest.mark.parametrize("hours", [0.25, 3, 24, 24 * 60])
def test_all_sums_of_the_ledger_agree(historian, records, hours):
    until_ns = FIRST_NS + round(hours * HOUR_NS)
    its = [r for r in records if r.wall_ns < until_ns]
    series = historian.series(FIRST_NS, until_ns, 100)
    assert 1 <= len(series.start_ns) <= 100
    assert series.records.sum() == len(its)
    assert series.volume_mm3.sum() == pytest.approx(math.fsum(r.volume_mm3 for r in its), rel=1e-12)
    assert series.mass_kg.sum() == pytest.approx(math.fsum(r.mass_kg for r in its), rel=1e-12)
    assert series.missing_mm.sum() == pytest.approx(math.fsum(r.length_mm for r in its if r.strip is None))
    flows = [r.strip.volume_flow_m3_h for r in its if r.strip]
    assert np.nanmin(series.flow_low_m3_h) == pytest.approx(min(flows))
    assert np.nanmax(series.flow_high_m3_h) == pytest.approx(max(flows))


def test_means_are_over_the_time_the_belt_moved(historian, records):
    series = historian.series(FIRST_NS, FIRST_NS + HOUR_NS // 4, 1)
    strips = [r.strip for r in records if r.strip and r.wall_ns < FIRST_NS + HOUR_NS // 4]
    seconds = math.fsum(300 / s.speed_mm_s for s in strips)
    flow = math.fsum(s.volume_mm3 for s in strips) / seconds * 3600e-9
    assert series.flow_m3_h[0] == pytest.approx(flow)
    assert series.mass_flow_t_h[0] == pytest.approx(flow * 1.6)
    assert series.speed_mm_s[0] == pytest.approx(1500)
    assert series.coverage[0] == pytest.approx(np.mean([s.coverage for s in strips]))


def test_minutes_and_records_give_the_same_sums(historian):
    minute = HOUR_NS // 60
    raw = historian.series(FIRST_NS, FIRST_NS + 20 * minute, 20)
    sums = historian.series(FIRST_NS, FIRST_NS + 60 * minute, 60)
    assert raw.width_ns == sums.width_ns == minute
    for name in ("flow_m3_h", "flow_low_m3_h", "mass_flow_t_h", "speed_mm_s", "coverage", "degraded_mm"):
        np.testing.assert_allclose(getattr(raw, name), getattr(sums, name)[:20], rtol=1e-12, err_msg=name)


def test_missing_value_is_not_zero(historian):
    series = historian.series(FIRST_NS - 10 * HOUR_NS, FIRST_NS - 8 * HOUR_NS, 50)
    assert np.isnan(series.flow_m3_h).all()
    assert not series.records.any()


def test_a_belt_that_stands_has_no_flow(tmp_path):
    historian = Historian(tmp_path, SETTINGS)
    record = ledger(1, length_mm=0.0)[0]
    historian.write([replace(record, strip=replace(require(record.strip), speed_mm_s=0.0))])
    for span in (HOUR_NS // 4, 10 * HOUR_NS):
        series = historian.series(FIRST_NS, FIRST_NS + max(span, HOUR_NS), 1)
        assert series.flow_m3_h[0] == 0
        assert series.speed_mm_s[0] == 0
    historian.close()


def test_day_sums_add_up(historian, records):
    day_ns = 24 * HOUR_NS
    midnight = FIRST_NS // day_ns * day_ns
    (day,) = historian.day_totals(midnight, midnight + day_ns)
    assert (day.day, day.records) == ("2026-09-21", 1080)
    assert day.volume_mm3 == pytest.approx(math.fsum(r.volume_mm3 for r in records))
    assert day.missing_mm == historian.totals.missing_mm
    assert historian.day_totals(midnight + 1, midnight + day_ns) == ()
