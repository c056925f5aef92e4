"""Blocks of a grid without a surface: strips that came into view, and holes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltscape.stereo.multiview.initialisation.unmeasured_regions import find_unmeasured_blocks


def mask_blocks(s: np.ndarray, align: int) -> np.ndarray:
    """Return the (H, W) mask of pixels in a block."""
    inside = np.zeros(s.shape, bool)
    for blocks in find_unmeasured_blocks(s, align):
        for block in blocks:
            inside[block] = True
    return inside


def test_image_without_a_surface_is_one_strip():
    whole = [(slice(0, 200), slice(0, 240))]
    assert find_unmeasured_blocks(np.full((200, 240), np.nan, np.float32), 3) == (whole, [])


def test_complete_surface_has_no_unmeasured_blocks():
    assert find_unmeasured_blocks(np.ones((200, 240), np.float32), 2) == ([], [])


@pytest.mark.parametrize("align", [1, 2, 3])
@pytest.mark.parametrize("side", ["left", "right", "top", "bottom"])
def test_edge_that_came_into_view_is_a_strip(side, align):
    s = np.ones((300, 400), np.float32)
    strip = {
        "left": (slice(None), slice(0, 60)), "right": (slice(None), slice(340, 400)),
        "top": (slice(0, 60), slice(None)), "bottom": (slice(240, 300), slice(None)),
    }[side]  # fmt: skip
    s[strip] = np.nan
    strips, holes = find_unmeasured_blocks(s, align)
    assert (len(strips), holes) == (1, [])
    inside = mask_blocks(s, align)
    assert inside[strip].all()
    assert inside.mean() < (60 + 60) / (400 if side in ("left", "right") else 300)


def test_holes_do_not_widen_a_strip():
    s = np.ones((512, 612), np.float32)
    s[400:] = np.nan
    holes = [(slice(40, 130), slice(60, 140)), (slice(150, 230), slice(400, 520))]
    for hole in holes:
        s[hole] = np.nan
    strips, boxes = find_unmeasured_blocks(s, 2)
    assert len(strips) == 1
    assert len(boxes) == 2
    inside = mask_blocks(s, 2)
    assert inside[400:].all()
    for rows, columns in holes:
        middle = slice(rows.start + 24, rows.stop - 24), slice(columns.start + 24, columns.stop - 24)
        assert inside[middle].all()
    assert inside.mean() < 0.55


def test_hole_that_touches_the_strip_is_separate():
    s = np.ones((512, 612), np.float32)
    s[420:] = np.nan
    s[200:420, 300:400] = np.nan
    strips, holes = find_unmeasured_blocks(s, 2)
    (strip,), (hole,) = strips, holes
    assert strip[1] == slice(0, 612)
    assert hole[1].stop - hole[1].start < 250


def test_small_gaps_are_not_swept():
    s = np.ones((200, 240), np.float32)
    s[np.random.default_rng(2).random(s.shape) < 0.2] = np.nan
    s[90:110, 100:130] = np.nan
    assert find_unmeasured_blocks(s, 2) == ([], [])


SIDE = st.integers(1, 300)
FIRST = st.integers(0, 299)


@given(SIDE, SIDE, st.integers(1, 8), FIRST, FIRST, st.integers(0, 300))
@settings(max_examples=60, deadline=None)
def test_blocks_are_not_empty_and_contain_large_unmeasured_regions(height, width, align, top, left, size):
    s = np.ones((height, width), np.float32)
    s[top : top + size, left : left + size] = np.nan
    for rows, columns in itertools.chain(*find_unmeasured_blocks(s, align)):
        for part, whole in ((rows, height), (columns, width)):
            assert part.start % align == 0
            assert 0 <= part.start < part.stop <= whole
    large = min(height, width) >= 96 and min(size, height - top, width - left) >= 48
    assert not large or mask_blocks(s, align)[np.isnan(s)].all()
