"""Sweep and aggregation in bands equal sweep and aggregation of each band."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.kernels import load
from beltscape.kernels.native import levels
from beltscape.kernels.sweep import bands
from tests.kernels.grids import STRAIGHT, texture, view_of_seed
from tests.kernels.rounding import emulated, first_alike, fusing_levels

everything = pytest.mark.parametrize("name", ["reference", *levels(), *emulated()])
every_level = pytest.mark.parametrize("level", levels())

LOW, HIGH = {"small_jump": 8, "large_jump": 80}, {"small_jump": 60, "large_jump": 300}


@given(st.integers(1, 3000))
def test_bands_keep_every_row_once(height):
    cut = bands(height)
    kept = np.concatenate([np.arange(band.keep_first, band.keep_last) for band in cut])
    np.testing.assert_array_equal(kept, np.arange(height))
    assert all(0 <= b.first <= b.keep_first < b.keep_last <= b.last <= height for b in cut)


def scene(height: int, width: int):
    images = [texture(i, height + 2, width) for i in range(3)]
    views = np.stack([view_of_seed(i, width, height) for i in range(3)])
    return texture(9, height, width), images, views, 0.0, 0.3, 7, 9.0


@every_level
@pytest.mark.parametrize("height", [1, 37, 64, 65, 230])
@pytest.mark.parametrize("jumps", [LOW, HIGH])
def test_it_is_sweep_and_aggregate_over_bands(level, height, jumps):
    kernels, given = load(level), scene(height, 33)
    index, margin = kernels.sweep_and_aggregate(*given, **jumps)
    for band in bands(height):
        parts = kernels.aggregate(kernels.sweep(*given, rows=(band.first, band.last)), **jumps)
        middle = slice(band.keep_first - band.first, band.keep_last - band.first)
        kept = slice(band.keep_first, band.keep_last)
        np.testing.assert_array_equal(index[kept], parts[0][middle])
        np.testing.assert_array_equal(margin[kept], parts[1][middle])


def test_native_is_the_reference_but_for_rounding():
    given = scene(110, 12)
    index, margin = load("reference").sweep_and_aggregate(*given, **LOW)
    for level in levels():
        found = load(level).sweep_and_aggregate(*given, **LOW)
        assert np.mean(abs(found[0] - index) > 0.1) < 0.01
        assert np.mean(abs(found[1] - margin) > 0.01) < 0.01


@everything
def test_a_step_between_two_planes_is_found(name):
    height, width, shift = 24, 60, np.array([3, 8])
    core = texture(4, height, width + 20)
    near = np.arange(width) >= 30
    images, views = [], []
    for sign in (1, -1):  # what a camera on either side sees of both planes
        aux = np.roll(core, sign * shift[0], axis=1)
        columns = np.arange(20, 20 + width)[near] + sign * shift[1]
        columns = columns[columns < core.shape[1]]
        aux[:, columns] = core[:, columns - sign * shift[1]]
        images.append(aux)
        views.append(STRAIGHT * np.where(np.arange(39) == 9, sign, 1).astype(np.float32))
        views[-1][14] = 20
    truth = np.where(near, shift[1], shift[0])
    index, _ = load(name).sweep_and_aggregate(
        core[:, 20:], images, np.stack(views), 0, 1, 16, 9.0, **LOW, best=1
    )
    inner = (abs(np.arange(width) - 30) > 6) & (np.arange(width) < 48)
    assert np.mean(abs(index - truth)[:, inner] < 0.5) > 0.99


@every_level
def test_the_number_of_threads_does_not_change_a_byte(level):
    given = scene(300, 40)
    one = load(level).sweep_and_aggregate(*given, **LOW, threads=1)
    for threads in (0, 2, 3):
        found = load(level).sweep_and_aggregate(*given, **LOW, threads=threads)
        assert found[0].tobytes() == one[0].tobytes()
        assert found[1].tobytes() == one[1].tobytes()


@every_level
@pytest.mark.parametrize("bands_at_once", [0, 1, 2, 3])
def test_how_many_costs_are_held_at_once_does_not_matter(level, bands_at_once, monkeypatch):
    given = scene(300, 40)
    whole = load(level).sweep_and_aggregate(*given, **LOW)
    monkeypatch.setattr("beltscape.kernels.sweep.SLAB_BYTES", bands_at_once * 64 * 40 * 7)
    found = load(level).sweep_and_aggregate(*given, **LOW, threads=2)
    assert found[0].tobytes() == whole[0].tobytes()
    assert found[1].tobytes() == whole[1].tobytes()


@pytest.mark.parametrize("name", emulated())
@pytest.mark.parametrize(("height", "jumps"), [(1, LOW), (65, HIGH), (150, LOW)])
def test_the_emulated_gpu_gives_the_bytes_of_the_processor(name, height, jumps):
    given = scene(height, 33)
    found = load(name).sweep_and_aggregate(*given, **jumps)
    expected = load(first_alike(name)).sweep_and_aggregate(*given, **jumps)
    assert [array.tobytes() for array in found] == [array.tobytes() for array in expected]


@pytest.mark.skipif(len(fusing_levels()) < 2, reason="only one level on this processor fuses")
def test_the_levels_that_round_alike_give_the_same_bytes():
    given = scene(120, 61)
    lowest, *others = [load(level).sweep_and_aggregate(*given, **LOW) for level in fusing_levels()]
    for other in others:
        assert other[0].tobytes() == lowest[0].tobytes()
        assert other[1].tobytes() == lowest[1].tobytes()
