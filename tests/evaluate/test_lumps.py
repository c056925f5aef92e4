"""Scores of lumps against known rocks."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.evaluate.lump_scores import compute_overlap, score_lumps
from beltscape.measure.lumps.lumps import Lump, Lumps, compute_distribution

SIZES = np.array([80.0, 40.0, 70.0, 5.0])
VOLUMES = 0.5 * SIZES**3


def squares() -> np.ndarray:
    """Four rocks, mm for px: squares a little under their sizes."""
    rock = np.full((220, 240), -1)
    for number, (v, u, side) in enumerate([(10, 10, 75), (110, 20, 37), (100, 110, 66), (5, 200, 4)]):
        rock[v : v + side, u : u + side] = number
    return rock


def lump(number: int, size: float, **flags: bool) -> Lump:
    known = {"occluded": False, "cut": False} | flags
    return Lump(
        number,
        (0.0, 0.0, 0.0),
        size,
        0.05 * size,
        size,
        size,
        size**2,
        size,
        0.5 * size**3,
        0.0,
        outline=1.0,
        **known,
    )


def lumps_of(labels: np.ndarray, found: list[Lump]) -> Lumps:
    size = np.array([one.size_mm for one in found])
    sizes = compute_distribution(size, size**3, np.array([50.0]))
    return Lumps(tuple(found), labels.astype(np.uint16), "core", 1.0, 8.0, np.nan, sizes, sizes, None)


def score(labels: np.ndarray, found: list[Lump], **options):
    return score_lumps(lumps_of(labels, found), squares(), SIZES, VOLUMES, pixel_mm=1.0, **options)


def test_the_truth_itself_is_perfect():
    one = score(np.where(squares() < 3, squares() + 1, 0), [lump(i + 1, SIZES[i]) for i in range(3)])
    assert (one.rocks, one.rocks_over, one.sized) == (3, 2, 3)
    assert one.recall == one.precision == one.iou == one.recall_over == one.precision_over == 1
    assert one.alarm_recall == one.alarm_precision == 1
    assert one.size_bias == one.size_error == one.size_iqr == 0


def test_missed_and_false_lumps_are_counted():
    labels = np.where(squares() == 0, 1, 0)
    labels[180:215, 180:235] = 2  # nothing is there
    one = score(labels, [lump(1, 80.0), lump(2, 65.0)])
    assert one.recall == pytest.approx(1 / 3)
    assert one.precision == one.precision_over == one.alarm_precision == 0.5
    assert one.recall_over == 0.5


def test_three_parts_match_nothing_and_a_shift_costs_iou():
    parts = np.where(squares() == 0, 1, 0)
    parts[:, 35:] *= 2
    parts[:, 60:] = np.where(parts[:, 60:] > 0, 3, 0)
    assert score(parts, [lump(1, 40.0), lump(2, 40.0), lump(3, 40.0)]).recall == 0
    shifted = np.roll(np.where(squares() == 0, 1, 0), 15, axis=1)
    found = compute_overlap(shifted, squares(), 1, 4)
    assert found.iou[found.rock == 0] == pytest.approx(60 / 90)


def test_sizes_are_scored_on_fully_visible_rocks():
    labels = np.where(squares() < 3, squares() + 1, 0)
    one = score(labels, [lump(1, 88.0), lump(2, 20.0, occluded=True), lump(3, 7.0, cut=True)])
    assert (one.sized, one.all_sized) == (1, 2)
    assert one.size_bias == pytest.approx(0.1)
    assert one.all_bias == pytest.approx((0.1 - 0.5) / 2)


def test_only_the_region_is_scored():
    labels = np.where(squares() == 0, 1, 0)
    region = np.zeros(labels.shape, bool)
    region[:95, :95] = True
    one = score(labels, [lump(1, 80.0)], region=region)
    assert (one.rocks, one.recall) == (1, 1.0)


def test_what_was_not_measured_is_counted_apart():
    labels = np.where(squares() == 0, 1, 0)
    one = score(labels, [lump(1, 80.0)], measured=squares() != 2)
    assert (one.rocks, one.rocks_measured) == (3, 2)
    assert (one.recall, one.recall_measured) == pytest.approx((1 / 3, 0.5))


def test_no_lumps_at_all():
    one = score(np.zeros(squares().shape), [])
    assert one.recall == 0
    assert np.isnan(one.precision)
    assert np.isnan(one.d50_mm)
    assert one.d50_heap_mm > 0


def test_shapes_must_agree():
    with pytest.raises(InputError, match="label picture"):
        score_lumps(lumps_of(np.zeros((5, 5)), []), squares(), SIZES, VOLUMES, pixel_mm=1.0)
