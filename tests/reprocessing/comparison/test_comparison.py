"""Figures of a comparison against ledgers whose difference is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import InputError
from tests.reprocessing.comparison.histories import (
    OTHER_RIG,
    compared,
    degraded,
    mark_missing,
    measured,
    moved,
    noisy,
    scaled,
    with_strips,
)
from tests.thorough import examples

RECORDS = measured()


def test_a_ledger_is_identical_to_itself_and_to_one_of_other_runs_and_times():
    renamed = [
        replace(record, run=7, number=record.number + 5, wall_ns=record.wall_ns + 9) for record in RECORDS
    ]
    for other in (RECORDS, renamed):
        comparison = compared(RECORDS, other)
        assert comparison.is_identical
        assert comparison.volume.difference == 0
        assert comparison.volume.agrees
        assert comparison.changes == comparison.stretches == ()


@pytest.mark.parametrize("name", ["volume_mm3", "sigma_mm3", "density_kg_m3", "coverage"])
def test_the_last_digit_of_one_value_is_found(name):
    at = next(place for place, record in enumerate(RECORDS) if record.standing == "valid")
    changed = with_strips([RECORDS[at]], lambda strip: {name: math.nextafter(getattr(strip, name), 0)})
    comparison = compared(RECORDS, [*RECORDS[:at], *changed, *RECORDS[at + 1 :]])
    assert comparison.differing == {name: 1}


def test_a_scaled_calibration_is_found_with_its_factor():
    comparison = compared(RECORDS, scaled(RECORDS, 1.01), of_second=OTHER_RIG)
    assert comparison.volume.relative == pytest.approx(0.01, rel=1e-9)
    assert comparison.mass is not None
    assert comparison.mass.relative == pytest.approx(0.01, rel=1e-9)
    assert {one.part for one in comparison.provenance if one.differing_mm} == {"rig"}
    assert np.nansum(comparison.intervals.volume.difference) == pytest.approx(comparison.volume.difference)


def test_another_density_changes_masses_alone():
    other = with_strips(RECORDS, lambda strip: {"density_kg_m3": strip.density_kg_m3 * 1.1})
    comparison = compared(RECORDS, other)
    assert comparison.volume.difference == 0
    assert comparison.mass is not None
    assert comparison.mass.relative == pytest.approx(0.1)
    assert {one.part for one in comparison.provenance if one.differing_mm} == {"density"}


def test_the_error_of_one_density_cancels_and_of_two_does_not():
    def dense(kg_m3: float, records=RECORDS):
        return with_strips(records, lambda _: {"density_kg_m3": kg_m3, "density_sigma_kg_m3": 32.0})

    same = compared(dense(1600), dense(1600, scaled(RECORDS, 1.01))).mass
    other = compared(dense(1600), dense(1650)).mass
    assert same is not None
    assert other is not None
    assert same.first_sigma == pytest.approx(0.02 * same.first, rel=0.1)
    assert same.difference_sigma < 0.1 * same.first_sigma
    assert other.difference_sigma == pytest.approx(
        math.hypot(other.first_sigma, other.second_sigma), rel=0.02
    )


def test_unknown_densities_leave_masses_out():
    other = with_strips(RECORDS, lambda _: {"density_kg_m3": math.nan})
    comparison = compared(RECORDS, other)
    assert comparison.mass is None
    assert comparison.without_density_mm == (0, pytest.approx(comparison.compared_mm))
    assert comparison.volume.agrees


def test_a_missing_sigma_gives_no_verdict():
    assert compared(RECORDS, with_strips(RECORDS, lambda _: {"sigma_mm3": math.nan})).volume.agrees is None


def test_missing_and_degraded_stretches_are_named_with_their_reasons():
    comparison = compared(RECORDS, degraded(mark_missing(RECORDS, range(10, 13)), range(30, 33)))
    kept = [record for record in RECORDS if record.number in range(10, 13) and record.standing != "missing"]
    first, second = comparison.wholes
    assert first.alone_mm == pytest.approx(sum(record.length_mm for record in kept))
    assert first.alone_mm3 == pytest.approx(sum(record.volume_mm3 for record in kept))
    assert second.alone_mm == 0
    assert comparison.volume.difference == 0
    reasons = {
        (part.first, part.second): [pair.second for pair in part.reasons] for part in comparison.changes
    }
    assert reasons["valid", "missing"] == ["frames lost"]
    assert reasons["valid", "degraded"] == ["cam3 is missing"]


def test_the_count_of_a_ledger_may_begin_elsewhere():
    plain, shifted = compared(RECORDS, noisy(RECORDS)), compared(RECORDS, moved(noisy(RECORDS), -123_456.7))
    assert shifted.alignment.offset_mm == pytest.approx(123_456.7)
    assert shifted.alignment.spread_mm < 1e-6
    assert shifted.volume.difference == pytest.approx(plain.volume.difference)
    assert shifted.changes == ()
    assert not shifted.is_identical


def test_a_count_that_drifts_is_laid_frame_by_frame():
    drifting = [replace(r, belt_mm=(1.01 * r.belt_mm[0], 1.01 * r.belt_mm[1])) for r in RECORDS]
    comparison = compared(RECORDS, drifting)
    assert comparison.alignment.spread_mm > 100
    assert comparison.volume.difference == pytest.approx(0, abs=1)
    assert comparison.volume.first == pytest.approx(comparison.volume.second)
    assert comparison.compared_mm == pytest.approx(compared(RECORDS, RECORDS).compared_mm)


def test_a_count_that_jumps_leaves_the_belt_between_to_one_ledger():
    late = next(place for place, record in enumerate(RECORDS) if place > 30 and record.strip is not None)
    gap = replace(
        RECORDS[late],
        belt_mm=(RECORDS[late].belt_mm[0], RECORDS[late].belt_mm[0] + 9000),
        strip=None,
        standing="missing",
        reason="the program did not run",
    )
    stopped = [*RECORDS[:late], gap, *moved(RECORDS[late:], 9000)]
    comparison = compared(RECORDS, stopped)
    assert comparison.volume.first == pytest.approx(comparison.volume.second)
    assert comparison.volume.difference == pytest.approx(0, abs=1)
    assert comparison.compared_mm == pytest.approx(compared(RECORDS, RECORDS).compared_mm)


def test_longer_strips_of_fewer_frames_have_the_same_volume():
    pairs = []
    for one, other in zip(RECORDS[::2], RECORDS[1::2], strict=True):
        if one.strip is None or other.strip is None or "missing" in (one.standing, other.standing):
            pairs += [one, other]
            continue
        volume, sigma = one.volume_mm3 + other.volume_mm3, one.sigma_mm3 + other.sigma_mm3
        joined = with_strips([other], lambda _, v=volume, s=sigma: {"volume_mm3": v, "sigma_mm3": s})[0]
        pairs.append(replace(joined, belt_mm=(one.belt_mm[0], other.belt_mm[1])))
    comparison = compared(RECORDS, pairs)
    assert len(pairs) < len(RECORDS)
    assert comparison.volume.difference == pytest.approx(0, abs=1)
    assert comparison.stretches == ()


def test_a_strip_compared_in_part_has_the_error_of_its_unknown_profile():
    at = next(place for place, record in enumerate(RECORDS) if record.standing == "valid")
    start, end = RECORDS[at].belt_mm
    halves = [
        replace(RECORDS[at], belt_mm=(start, (start + end) / 2), strip=None, standing="missing"),
        with_strips(
            [replace(RECORDS[at], belt_mm=((start + end) / 2, end))],
            lambda strip: {"volume_mm3": strip.volume_mm3 / 2, "sigma_mm3": 0.0, "common_sigma_mm3": 0.0},
        )[0],
    ]
    comparison = compared(RECORDS[at : at + 1], halves)
    volume = RECORDS[at].volume_mm3
    assert comparison.volume.first == pytest.approx(volume / 2)
    assert comparison.volume.difference_sigma >= 0.25 * volume / math.sqrt(3)


def test_the_pattern_of_a_difference_is_found():
    long = measured(400)
    lifted = with_strips(long, lambda strip: {"volume_mm3": strip.volume_mm3 + 5000.0 * 300.0})
    # loads differ up to fourfold, so both patterns can be told apart
    for other, kind, value in (
        (scaled(long, 1.05), "proportional", 0.05 / 1.025),
        (lifted, "constant", 5000.0),
    ):
        back, forth = compared(other, long).pattern, compared(long, other).pattern
        assert back is not None
        assert forth is not None
        assert (back.kind, forth.kind) == (kind, kind)
        assert forth.value == pytest.approx(value, abs=2 * forth.sigma)
        assert back.value == pytest.approx(-forth.value)
    assert compared(long, noisy(long)).pattern is None
    assert compared(long, scaled(long[:200], 1.3) + long[200:]).pattern is None


def test_the_ten_stretches_that_differ_most_are_those_that_were_changed():
    changed = [scaled([record], 1.3)[0] if 40 <= record.number < 44 else record for record in noisy(RECORDS)]
    stretches = compared(RECORDS, changed).stretches
    counted = [r for r in RECORDS if 40 <= r.number < 44 and r.standing != "missing"]
    assert stretches[0].from_mm >= counted[0].belt_mm[0] - 1e-6
    assert stretches[0].to_mm <= counted[-1].belt_mm[1] + 1e-6
    assert stretches[0].first.first_frame == stretches[0].second.first_frame
    assert stretches[0].difference_mm3 == pytest.approx(
        stretches[0].second.volume_mm3 - stretches[0].first.volume_mm3
    )
    assert len(stretches) <= 10


def test_sigma_of_the_difference_is_that_of_many_measurements():
    """Shared errors that are one error in both ledgers, or one in each; own errors always independent."""
    rng, measured_mm3 = np.random.default_rng(4), [r for r in RECORDS if r.standing != "missing"]
    own = np.array([0.8 * r.strip.sigma_mm3 for r in measured_mm3 if r.strip])  # √(1 - 0.6²)
    shared = sum(0.6 * r.strip.sigma_mm3 for r in measured_mm3 if r.strip)
    apart = rng.normal(0, 1, (2, 4000, len(own))) @ own
    common = rng.normal(0, 1, (2, 4000)) * shared
    for rig, differences in (
        (None, apart[1] - apart[0]),  # the same error on both sides
        (OTHER_RIG, apart[1] - apart[0] + common[1] - common[0]),
    ):
        sigma = compared(RECORDS, RECORDS, of_second=rig).volume.difference_sigma
        assert sigma == pytest.approx(float(differences.std()), rel=0.04)
    sigma = compared(RECORDS, RECORDS).volume.first_sigma
    assert sigma == pytest.approx(float((apart[0] + common[0]).std()), rel=0.04)


def test_an_unknown_shared_part_does_not_vanish_from_the_difference():
    unknown = with_strips(RECORDS, lambda _: {"common_sigma_mm3": math.nan})
    known = compared(RECORDS, RECORDS).volume.difference_sigma
    assert compared(unknown, unknown).volume.difference_sigma > known
    assert compared(unknown, unknown, of_second=OTHER_RIG).volume.difference_sigma > 2 * known


def test_unknown_provenance_is_another_rig():
    assert compared(RECORDS, RECORDS, {}).same_rig_mm == 0
    assert compared(RECORDS, RECORDS).same_rig_mm == compared(RECORDS, RECORDS).compared_mm


def test_times_that_a_recording_rounded_are_those_of_the_same_frames():
    rounded = with_strips(
        RECORDS, lambda strip: {"time_ns": round(((strip.time_ns or 0) + 137) * 1e-9 * 1e9)}
    )
    comparison = compared(RECORDS, rounded)
    assert comparison.differing.keys() == {"time_ns"}
    assert comparison.alignment.shared_frames == compared(RECORDS, RECORDS).alignment.shared_frames


def test_frames_in_common_are_needed_in_the_same_order():
    renamed = with_strips(RECORDS, lambda strip: {"frame": f"other {strip.frame}"})
    with pytest.raises(InputError, match="no frame of the same name and time"):
        compared(RECORDS, renamed)
    later = with_strips(RECORDS, lambda strip: {"time_ns": (strip.time_ns or 0) + 1500})
    with pytest.raises(InputError, match="no frame of the same name and time"):
        compared(RECORDS, later)
    swapped = [replace(record, strip=RECORDS[-1 - at].strip) for at, record in enumerate(RECORDS)]
    with pytest.raises(InputError, match="in another order"):
        compared(RECORDS, swapped)
    with pytest.raises(InputError, match="no belt in common"):
        compared(RECORDS, [replace(record, standing="missing") for record in RECORDS])


@pytest.mark.parametrize("times", [None, 0])
def test_frames_without_a_clock_are_compared_along_the_belt(times):
    records = with_strips(RECORDS, lambda _: {"time_ns": None if times is None else times})
    if times == 0:  # every recording begins again at 0
        records = with_strips(records, lambda strip: {"time_ns": int(strip.frame) % 20})
    comparison = compared(records, noisy(records))
    assert comparison.intervals.axis == "belt"
    assert comparison.intervals.volume.difference.sum() == pytest.approx(comparison.volume.difference)


changes = st.fixed_dictionaries(
    {
        "factor": st.floats(0.5, 2),
        "seed": st.integers(0, 99),
        "by_mm": st.sampled_from([0.0, 0.1, -5000.3, 1e8]),
        "lost": st.integers(1, 50),
        "of_second": st.sampled_from([None, OTHER_RIG, {}]),
    }
)


@examples(25)
@given(changes)
def test_the_comparison_of_b_with_a_is_the_opposite(change):
    numbers = range(change["lost"], change["lost"] + 4)
    other = moved(
        mark_missing(scaled(noisy(RECORDS, change["seed"]), change["factor"]), numbers), change["by_mm"]
    )
    forth = compared(RECORDS, other, of_second=change["of_second"])
    of_first = forth.second.runs[1].provenance
    back = compared(other, RECORDS, of_first, forth.first.runs[1].provenance)
    assert back.volume.difference == pytest.approx(-forth.volume.difference, rel=1e-9, abs=1)
    assert back.volume.difference_sigma == pytest.approx(forth.volume.difference_sigma)
    assert (back.volume.first, back.volume.first_sigma) == pytest.approx(
        (forth.volume.second, forth.volume.second_sigma)
    )
    assert back.volume.agrees == forth.volume.agrees
    np.testing.assert_allclose(
        back.intervals.volume.difference, -forth.intervals.volume.difference, rtol=1e-6, atol=10
    )
    assert [(p.second, p.first, round(p.length_mm, 3)) for p in back.changes] == [
        (p.first, p.second, round(p.length_mm, 3)) for p in forth.changes
    ]
