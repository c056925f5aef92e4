"""The ledger's sums without rounding loss."""

from __future__ import annotations

import math
from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from beltscape.sinks.historian.ledger import LedgerTotals, add_compensated, read_sums
from tests.optional import require
from tests.sinks.ledgers import ledger

values = st.lists(st.floats(-1e12, 1e12), max_size=200)


@given(values)
def test_sums_lose_nothing(numbers):
    pair = (0.0, 0.0)
    for number in numbers:
        pair = add_compensated(pair, number)
    assert abs(math.fsum([*pair, *(-n for n in numbers)])) <= 1e-28 * math.fsum(map(abs, numbers)) * len(
        numbers
    )


def test_sum_of_a_million_tenths_is_exact():
    pair, naive = (0.0, 0.0), 0.0
    for _ in range(1_000_000):
        pair, naive = add_compensated(pair, 0.1), naive + 0.1
    assert pair[0] == math.fsum([0.1] * 1_000_000)
    assert naive != pair[0]


def test_totals_are_the_records_sums():
    records = [*ledger(40), *ledger(30, 41, run=2)]
    sums = LedgerTotals()
    for record in records:
        sums = sums.add_record(record)
    totals = sums.totals
    assert totals.records == 70
    assert totals.volume_mm3 == math.fsum(r.volume_mm3 for r in records)
    assert totals.mass_kg == math.fsum(r.mass_kg for r in records)
    assert totals.missing_mm == math.fsum(r.length_mm for r in records if r.standing == "missing")
    assert math.isclose(totals.length_mm, records[-1].belt_mm[1] - records[0].belt_mm[0], rel_tol=1e-14)
    # errors in common stay from run to run
    assert totals.sigma_mm3 == records[39].run_sigma_mm3 + records[69].run_sigma_mm3
    assert totals.since_ns == records[0].wall_ns


def test_one_load_without_density_makes_the_mass_unknown():
    first, second = ledger(2)
    unknown = replace(first, strip=replace(require(first.strip), density_kg_m3=math.nan))
    assert math.isnan(LedgerTotals().add_record(unknown).add_record(second).totals.mass_kg)
    empty = replace(first, strip=replace(require(first.strip), density_kg_m3=math.nan, volume_mm3=0.0))
    assert LedgerTotals().add_record(empty).add_record(second).totals.mass_kg == second.mass_kg


def test_nan_volume_adds_nothing():
    first, second = ledger(2)
    hidden = replace(first, strip=replace(require(first.strip), volume_mm3=math.nan))
    totals = LedgerTotals().add_record(hidden).add_record(second).totals
    assert totals.volume_mm3 == second.volume_mm3
    assert totals.mass_kg == second.mass_kg


@given(st.integers(1, 30), st.integers(0, 10_000))
def test_text_reads_back_and_damage_is_detected(count, place):
    sums = LedgerTotals()
    for record in ledger(count, sections=False):
        sums = sums.add_record(record)
    text = sums.text()
    assert read_sums(text) == sums
    place %= len(text)
    if text[place].isdigit():
        changed = text[:place] + str((int(text[place]) + 1) % 10) + text[place + 1 :]
        assert read_sums(changed) in (None, sums)
    assert read_sums(text[:place]) is None
