"""Lumps of a fused belt: balls at known places, over the borders of stretches, at the ends, and not measured."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from beltscape.core.errors import MeasureError
from beltscape.measure.lumps import fused_belt
from beltscape.measure.lumps.fused_belt import measure_belt_lumps
from beltscape.measure.lumps.lumps import FINES
from beltscape.measure.lumps.settings import LumpSettings
from tests.synthetic.belts import CELL_MM, COLUMNS, S_MM, make_belt

DEFAULT = LumpSettings()
ROWS = 7 * COLUMNS
BORDERS_MM = [S_MM + CELL_MM * COLUMNS * widths for widths in (2, 2.5, 3, 4.5)]
"""Where the second stretch begins, its own part, where the first one ends, and where the third one's own begins."""
BALLS = [
    *((-55.0, S_MM + 80 + 120 * number, 20.0 + number) for number in range(10)),
    *((45.0, middle_mm + 3.0, 30.0) for middle_mm in BORDERS_MM),
]


def measure(belt, settings=DEFAULT):
    return measure_belt_lumps(belt.heights, belt.measured, settings, belt.counted_mm)


@pytest.fixture(scope="module")
def long_belt():
    belt, which = make_belt(BALLS, ROWS)
    return belt, which, measure(belt)


def test_each_ball_is_one_lump_at_its_place_and_of_its_size(long_belt):
    _, which, lumps = long_belt
    assert len(lumps.lumps) == len(BALLS)
    for number, (x, s, radius) in enumerate(BALLS):
        lump = min(lumps.lumps, key=lambda one: np.hypot(one.center_mm[0] - x, one.center_mm[1] - s))
        assert lump.center_mm[:2] == pytest.approx((x, s), abs=0.1 * radius)
        assert lump.size_mm == pytest.approx(2 * radius, rel=0.12)
        assert abs(lump.size_mm - 2 * radius) < 3 * lump.sigma_mm
        assert not lump.cut
        assert not lump.occluded
        own, true = lumps.labels == lump.number, which == number
        assert (own & true).sum() / (own | true).sum() > 0.85
    assert lumps.frame == "fused belt"
    assert lumps.all.count == lumps.whole.count == len(BALLS)
    assert set(np.unique(lumps.labels)) <= {*range(len(BALLS) + 1), FINES}


def test_a_belt_in_stretches_has_the_lumps_of_the_whole(long_belt, monkeypatch):
    belt, _, lumps = long_belt
    assert len(list(fused_belt._split(ROWS, COLUMNS))) == 3
    monkeypatch.setattr(fused_belt, "_split", lambda rows, _: [fused_belt._Stretch(0, rows, 0, rows)])
    whole = measure(belt)
    pairs = zip(
        *(sorted(each.lumps, key=lambda one: one.center_mm[1]) for each in (lumps, whole)), strict=True
    )
    for one, other in pairs:
        assert one.center_mm == pytest.approx(other.center_mm, abs=1)
        assert one.size_mm == pytest.approx(other.size_mm, rel=0.05)


@pytest.mark.parametrize(
    ("rows", "count"), [(1, 1), (COLUMNS, 1), (3 * COLUMNS, 1), (3 * COLUMNS + 1, 2), (1000, 5)]
)
def test_stretches_share_the_belt_among_them(rows, count):
    stretches = list(fused_belt._split(rows, COLUMNS))
    assert len(stretches) == count
    assert (stretches[0].own_first, stretches[-1].own_end) == (0, rows)
    for one, other in pairwise(stretches):
        assert one.own_end == other.own_first
        assert one.own_end - other.first >= COLUMNS // 2
        assert one.end - one.own_end >= COLUMNS // 2


def test_lumps_at_the_ends_are_cut_and_not_in_the_distribution():
    belt, _ = make_belt([(0.0, S_MM + 5, 30.0), (0.0, S_MM + 150, 28.0), (0.0, S_MM + 298, 30.0)], 150)
    lumps = sorted(measure(belt).lumps, key=lambda one: one.center_mm[1])
    assert [lump.cut for lump in lumps] == [True, False, True]
    assert measure(belt).all.count == 1
    counted = (S_MM + 150, S_MM + 400.0)  # ends in the middle of a lump
    (half, _) = sorted(measure(replace(belt, counted_mm=counted)).lumps, key=lambda one: one.center_mm[1])
    assert half.cut


def test_what_no_frame_measured_is_no_lump():
    belt, _ = make_belt([(-40.0, S_MM + 100, 30.0), (40.0, S_MM + 100, 30.0)], 100)
    measured = belt.measured.copy()
    measured[:, COLUMNS // 2 :] = 0.2
    (lump,) = measure(replace(belt, measured=measured)).lumps
    assert lump.center_mm[0] == pytest.approx(-40, abs=3)
    assert not lump.cut  # the belt beside it was in view


def test_a_bare_belt_and_an_unseen_one_have_no_lumps():
    belt, _ = make_belt([], 100)
    assert measure(belt).lumps == ()
    unseen = replace(belt.heights, height_mm=np.full(belt.heights.height_mm.shape, np.nan))
    lumps = measure(replace(belt, heights=unseen, measured=np.zeros(belt.measured.shape)))
    assert lumps.lumps == ()
    assert np.isnan(lumps.fines_share)


def test_more_lumps_than_labels_are_refused(long_belt, monkeypatch):
    monkeypatch.setattr(fused_belt, "MAX_LUMPS", 3)
    with pytest.raises(MeasureError, match="more than 3 lumps"):
        measure(long_belt[0])
