"""Plane sweep: each level agrees with the reference; properties of any scene."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.native import levels
from tests.kernels.grids import STRAIGHT, WIDTHS, texture, view_of_seed
from tests.kernels.rounding import emulated, first_alike
from tests.strategies import seeds

everything = pytest.mark.parametrize("name", ["reference", *levels(), *emulated()])
widths = st.sampled_from(WIDTHS)


def scene(seed: int, height: int, width: int, count: int):
    """Core (height, width), `count` images about as large, and their views; a few NaN in one image each."""
    sizes = np.random.default_rng(seed).integers(1, 9, (count, 2)) + np.array([height, width])
    images = [texture(seed + i, *size) for i, size in enumerate(sizes)]
    images[-1][::11, ::7] = np.nan
    views = np.stack([view_of_seed(seed + i, width, height) for i in range(count)])
    return texture(seed + 99, height, width), images, views


@given(widths, widths, seeds, st.integers(1, 4), st.integers(1, 5), st.sampled_from([4, 5, 16, 33]))
def test_native_is_the_reference_but_for_rounding(height, width, seed, count, best, planes):
    given = (*scene(seed, height, width, count), 0.0, 0.3, planes, 9.0)
    expected = load("reference").sweep(*given, best=best).astype(int)
    every = {level: load(level).sweep(*given, best=best) for level in (*levels(), *emulated())}
    for level, found in every.items():
        assert found.shape == (height, width, planes)
        assert found.tobytes() == every[first_alike(level)].tobytes()
        far = abs(found - expected) > 1  # a sample at the very border may be in for one and out for the other
        assert far.sum() <= 3 + 0.002 * far.size


@everything
@given(seeds, st.integers(4, 12), st.floats(0.5, 2), st.floats(-30, 30))
def test_the_plane_on_which_the_surface_lies_costs_nothing(name, seed, shift, gain, offset):
    """An image shifted by whole pixels, whatever its brightness where the floor of the noise is low."""
    core = texture(seed, 20, 40)
    aux = np.roll(core, shift, axis=1) + np.float32(offset)
    cost = load(name).sweep(core, [aux], STRAIGHT[None], 0, 1, 16, 4.0)
    inside = cost[2:-4, 1 : 40 - shift - 4]  # both samplings need their neighbours
    assert (inside[..., shift] == 0).all()
    assert inside[..., np.arange(16) != shift].mean() > 60
    louder = load(name).sweep(core, [aux * np.float32(gain)], STRAIGHT[None], 0, 1, 16, 4.0)
    assert louder[2:-4, 1 : 40 - shift - 4, shift].max() <= np.ceil(120 * (1 - gain) ** 2 / (1 + gain**2))


@everything
@given(seeds, st.integers(0, 9))
def test_rows_are_cut_from_the_whole(name, seed, first):
    given = (*scene(seed, 41, 17, 2), 0.0, 0.5, 4, 9.0)
    whole = load(name).sweep(*given)
    np.testing.assert_array_equal(
        load(name).sweep(*given, rows=(first, first + 32)), whole[first : first + 32]
    )


@everything
@given(seeds)
def test_the_order_of_the_views_does_not_matter(name, seed):
    core, images, views = scene(seed, 15, 18, 3)
    forth = load(name).sweep(core, images, views, 0, 0.5, 5, 9.0)
    back = load(name).sweep(core, images[::-1], views[::-1], 0, 0.5, 5, 9.0)
    np.testing.assert_array_equal(forth, back)


@everything
@given(seeds)
def test_a_blind_view_costs_nothing_beyond_the_best(name, seed):
    core, images, views = scene(seed, 15, 18, 2)
    alone = load(name).sweep(core, images, views, 0, 0.5, 5, 9.0)
    blind = np.concatenate([views, STRAIGHT[None] * np.float32(-1)])  # behind it
    nothing = [*images, texture(seed, 9, 9)]
    np.testing.assert_array_equal(load(name).sweep(core, nothing, blind, 0, 0.5, 5, 9.0), alone)
    dark = [*images, np.full((15, 18), np.nan)]
    seen = np.concatenate([views, STRAIGHT[None]])
    np.testing.assert_array_equal(load(name).sweep(core, dark, seen, 0, 0.5, 5, 9.0), alone)
    assert (load(name).sweep(core, dark[-1:], seen[-1:], 0, 0.5, 5, 9.0) == 120).all()


@everything
@pytest.mark.parametrize("size", [(2, 2), (3, 9), (9, 3)])
def test_an_image_too_small_for_cubic_interpolation_is_not_seen(name, size):
    cost = load(name).sweep(texture(1, 8, 9), [texture(2, *size)], STRAIGHT[None], 0, 1, 4, 9.0)
    assert (cost == 120).all()


@pytest.mark.parametrize("level", levels())
def test_the_number_of_threads_does_not_change_a_byte(level):
    given = (*scene(3, 131, 70, 3), 0.0, 0.3, 9, 9.0)
    one = load(level).sweep(*given, threads=1)
    for threads in (0, 2, 7):
        assert load(level).sweep(*given, threads=threads).tobytes() == one.tobytes()


@everything
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"core": np.zeros(5)}, "core must have the shape (H, W), not (5,)"),
        ({"images": []}, "a sweep needs at least one auxiliary image"),
        ({"images": [np.zeros((5, 1))]}, "images[0] must be of at least 2 × 2 pixels, not (5, 1)"),
        ({"views": np.zeros((2, 39))}, "views must have the shape (1, 39), not (2, 39)"),
        ({"rows": (3, 9)}, "rows must lie within (0, 8), not (3, 9)"),
        ({"rows": (4, 4)}, "rows must lie within (0, 8), not (4, 4)"),
        ({"planes": 3}, "planes must be 4 to 4096, not 3"),
        ({"planes": 4097}, "planes must be 4 to 4096, not 4097"),
        ({"floor": 0.0}, "floor must be positive, not 0.0"),
        ({"best": 0}, "best must be at least 1, not 0"),
    ],
)
def test_wrong_input_is_named(name, change, message):
    right = {"core": np.zeros((8, 9)), "images": [np.zeros((5, 5))], "views": np.zeros((1, 39))}
    with pytest.raises(KernelError) as error:
        load(name).sweep(**(right | {"first": 0, "step": 1, "planes": 4, "floor": 1.0} | change))
    assert str(error.value) == message
