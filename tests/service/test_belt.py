"""The belt's surface for the page: cells, rows and encoding."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.events import BeltStretch
from beltscape.service.belt_surface import FILLED, UNKNOWN, SurfaceWindow, decode_heights, encode_heights

X = np.arange(-100, 101, 5).astype(np.float32)


def make_stretch(start_mm: float, rows: int, height=None, *, cell_mm: float = 5.0, x=X) -> BeltStretch:
    s = start_mm + np.arange(rows) * cell_mm
    load = np.broadcast_to((s[:, None] % 700) / 7, (rows, x.size)) if height is None else height
    return BeltStretch(start_mm, cell_mm, x, load.astype(np.float32), np.isfinite(load))


@given(st.lists(st.floats(-99, 1900, width=32), min_size=1, max_size=30), st.booleans())
def test_heights_survive_encoding_to_half_a_step(heights, measured):
    h = np.array(heights, np.float32)
    back, seen = decode_heights(encode_heights(h, np.full(h.shape, measured)))
    assert np.abs(back - h).max() <= 0.5 / 16 + 1e-4
    assert (seen == measured).all()


def test_heights_out_of_range_are_clipped_and_nan_is_unknown():
    counts = encode_heights(np.array([np.nan, -1e6, 1e6]), np.array([False, False, False]))
    assert counts[0] == UNKNOWN
    assert decode_heights(counts)[0][1] == -100
    assert counts[2] != UNKNOWN and counts[2] >= FILLED


@given(st.lists(st.integers(1, 60), min_size=1, max_size=12), st.integers(0, 50))
def test_rows_do_not_depend_on_the_cutting_of_stretches(lengths, start):
    total = sum(lengths) + 4
    whole, pieces = SurfaceWindow(20, 10), SurfaceWindow(20, 10)
    whole.add(make_stretch(start * 5, total))
    at = start
    for length in [*lengths, 4]:
        pieces.add(make_stretch(at * 5, length))
        at += length
    a, b = whole.get_rows_after(), pieces.get_rows_after()
    assert a is not None and b is not None
    assert (a.first, a.epoch) == (b.first, b.epoch)
    np.testing.assert_array_equal(a.counts, b.counts)


def test_cells_are_means_and_measured_from_half_on():
    height = np.tile(np.arange(6)[:, None] * 10.0, (1, X.size))
    measured = np.zeros(height.shape, bool)
    measured[0], measured[2], measured[3, : X.size // 2] = True, True, True
    window = SurfaceWindow(20, 10)
    window.add(BeltStretch(0, 5, X, height.astype(np.float32), measured))
    rows = window.get_rows_after()
    assert rows is not None
    back, seen = decode_heights(rows.counts)
    np.testing.assert_allclose(back, [[5] * rows.x_mm.size, [25] * rows.x_mm.size], atol=0.04)
    assert seen.all()
    assert rows.x_mm.size == 21 and rows.cell_mm == 10


def test_only_new_rows_are_returned_and_memory_is_bounded():
    window = SurfaceWindow(1, 10)
    window.add(make_stretch(0, 101))
    mark = window.mark
    assert window.get_rows_after(mark) is None
    window.add(make_stretch(505, 21))
    rows = window.get_rows_after(mark)
    assert rows is not None and rows.first == mark[1] and rows.first + len(rows.counts) == window.mark[1]
    for k in range(50):
        window.add(make_stretch(610 + k * 105, 21))
    rows = window.get_rows_after((mark[0], 0))
    assert rows is not None and len(rows.counts) == 100


def test_a_gap_is_unknown_and_a_step_back_starts_an_epoch():
    window = SurfaceWindow(20, 10)
    window.add(make_stretch(0, 21))
    window.add(make_stretch(400, 21))
    rows = window.get_rows_after()
    assert rows is not None
    known = (rows.counts != UNKNOWN).any(axis=1)
    assert known[:10].all() and not known[11:40].any() and known[40:].all()
    epoch = window.mark[0]
    window.add(make_stretch(100, 21))
    fresh = window.get_rows_after((epoch, 40))
    assert fresh is not None and fresh.epoch == epoch + 1 and fresh.first == 10


def test_another_grid_starts_an_epoch():
    window = SurfaceWindow(20, 10)
    window.add(make_stretch(0, 21))
    window.add(make_stretch(105, 21, x=X + 1))
    assert window.mark[0] == 2


@pytest.mark.parametrize("rows", [0, 1])
def test_an_incomplete_row_is_not_returned(rows):
    window = SurfaceWindow(20, 10)
    window.add(make_stretch(0, rows))
    assert window.get_rows_after() is None
