"""Propagation: each level agrees with the reference; a smeared step returns to its edge."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.native import levels
from tests.kernels.grids import STRAIGHT, WIDTHS, surface, texture, view_of_seed
from tests.kernels.rounding import emulated, first_alike
from tests.strategies import seeds
from tests.thorough import examples

every_level = pytest.mark.parametrize("level", (*levels(), *emulated()))
everything = pytest.mark.parametrize("name", ["reference", *levels(), *emulated()])

OFFSETS = np.array([(2, 0), (-2, 0), (0, 3), (0, -3), (4, 4), (-4, -4), (60, -1)])


def scene(seed: int, height: int, width: int, views: int) -> dict[str, Any]:
    """What `propagate` is given: a rough surface with holes, unrelated textures, buffers of another surface."""
    rng = np.random.default_rng(seed)
    s, other = surface(seed, height, width), surface(seed + 1, height, width)
    slopes = rng.normal(0, 0.2, (2, height, width)).astype(np.float32)
    slopes[rng.random(slopes.shape) < 0.05] = np.nan
    rows = np.stack([view_of_seed(seed + i) for i in range(views)])
    sizes = [(30 + 9 * i, 40 - 3 * i) for i in range(views)]
    return {
        "s": s,
        "slope_u": slopes[0],
        "slope_v": slopes[1],
        "core": texture(seed, height, width),
        "images": [texture(seed + i, h, w) for i, (w, h) in enumerate(sizes)],
        "views": rows,
        "buffers": load("reference").inverse_depth_buffers(other, rows, sizes),
        "offsets": OFFSETS,
        "floor": 4.0,
        "tolerance": 1.0,
    }


def blobs(seed: int, height: int, width: int) -> np.ndarray:
    """(height, width) uint8, 1 in a few rectangles."""
    rng = np.random.default_rng(seed)
    active = np.zeros((height, width), np.uint8)
    for _ in range(3):
        y, x = rng.integers(0, height), rng.integers(0, width)
        active[y : y + 6, x : x + 9] = 1
    return active


def assert_agree(found, expected):
    """Equal, but for one pixel and few more where float32 may decide otherwise."""
    same = np.isclose(found.s, expected.s, atol=1e-4, equal_nan=True)
    assert (~same).sum() <= 1 + 0.002 * same.size
    for name in ("slope_u", "slope_v", "cost", "margin"):
        close = np.isclose(getattr(found, name), getattr(expected, name), atol=2e-4, equal_nan=True)
        assert (same & ~close).sum() <= 0.002 * same.size


@every_level
@examples(25)
@given(
    seeds,
    st.sampled_from(WIDTHS),
    st.sampled_from(WIDTHS),
    st.integers(1, 4),
    st.integers(1, 8),
    st.booleans(),
)
def test_native_agrees_with_the_reference(level, seed, height, width, views, candidates, partly):
    given_ = scene(seed, height, width, views) | {"candidates": candidates}
    if partly:
        given_["active"] = blobs(seed, height, width)
    found, expected = (load(name).propagate(**given_) for name in (level, "reference"))
    assert all(field.dtype == np.float32 and field.shape == (height, width) for field in found)
    assert_agree(found, expected)


@every_level
def test_bands_and_tiles_join_as_in_the_reference(level):
    given_ = scene(5, 145, 133, 3)
    assert_agree(load(level).propagate(**given_), load("reference").propagate(**given_))


@pytest.mark.parametrize("partly", [False, True])
def test_threads_and_levels_do_not_change_a_byte(partly):
    given_ = scene(1, 280, 150, 4)
    if partly:
        given_["active"] = blobs(1, 280, 150)
    for level in (*levels(), *emulated()):
        results = [
            b"".join(field.tobytes() for field in load(name).propagate(**given_, threads=threads))
            for name in (level, first_alike(level))
            for threads in (1, 3)
        ]
        assert len(set(results)) == 1


@every_level
def test_what_memory_held_before_does_not_matter(level):
    given_ = scene(1, 17, 17, 1) | {"candidates": 4, "active": blobs(1, 17, 17)}
    results = set()
    for value in (np.nan, 0.0, 10.0, 1e30):  # 10: near the inverse depths of the scene
        for size in (900, 4_000, 20_000):
            held = [np.full(size, value, np.float32) for _ in range(8)]
            del held
            found = load(level).propagate(**given_, threads=1)
            results.add(b"".join(field.tobytes() for field in found))
    assert len(results) == 1


@everything
def test_a_smeared_step_returns_to_its_edge(name):
    height, width, edge = 40, 64, 32
    truth = np.broadcast_to(np.where(np.arange(width) < edge, 6, 12), (height, width)).astype(np.float32)
    flat, core = np.zeros_like(truth), texture(3, height, width)
    images, views = [], []
    for sign in (1, -1):
        view, image = STRAIGHT.copy(), texture(8, height, width + 40)
        view[9], view[14] = sign, 20  # 20 px more to both sides
        for s in (6, 12):  # what is nearer overwrites
            columns = np.flatnonzero(truth[0] == s)
            image[:, columns + sign * s + 20] = core[:, columns]
        images.append(image)
        views.append(view)
    smeared = truth.copy()
    smeared[:, edge - 5 : edge] = 12  # the foreground has grown
    buffers = load(name).inverse_depth_buffers(
        smeared, np.stack(views), [image.shape[::-1] for image in images]
    )
    found = load(name).propagate(
        smeared,
        flat,
        flat,
        core,
        images,
        np.stack(views),
        buffers,
        offsets=np.array([(8, 0), (-8, 0), (0, 8), (0, -8)]),
        floor=4.0,
    )
    assert (smeared == truth).mean() < 0.93
    assert (found.s == truth).mean() > 0.98  # windows across an edge may be wrong by a pixel
    assert np.median(found.cost) < 1e-3


@everything
@given(seeds)
@examples(10)
def test_without_an_active_pixel_everything_stays(name, seed):
    given_ = scene(seed, 20, 33, 2)
    given_["active"] = np.zeros((20, 33), bool)
    found = load(name).propagate(**given_)
    np.testing.assert_array_equal(found.s, given_["s"])
    np.testing.assert_array_equal(found.slope_u, np.nan_to_num(given_["slope_u"]))
    np.testing.assert_array_equal(np.isnan(found.cost), np.isnan(given_["s"]))
    np.testing.assert_array_equal(found.margin[~np.isnan(given_["s"])], 1)


@every_level
@given(seeds)
@examples(10)
def test_inactive_pixels_keep_their_own_whatever_is_around_them(level, seed):
    given_ = scene(seed, 30, 53, 3)
    active = blobs(seed, 30, 53)
    found = load(level).propagate(**given_, active=active)
    np.testing.assert_array_equal(found.s[active == 0], given_["s"][active == 0])


@everything
def test_a_hole_is_filled_from_the_side(name):
    given_ = scene(2, 24, 40, 2)
    given_["s"] = np.full((24, 40), 10, np.float32)
    given_["slope_u"] = given_["slope_v"] = np.zeros((24, 40), np.float32)
    given_["s"][10:12, 20:22] = np.nan
    found = load(name).propagate(**given_)
    np.testing.assert_array_equal(found.s, 10)
    given_["offsets"] = np.zeros((0, 2), int)
    none = load(name).propagate(**given_)
    np.testing.assert_array_equal(none.s, given_["s"])
    np.testing.assert_array_equal(np.isnan(none.cost), np.isnan(given_["s"]))


@everything
def test_a_pixel_that_no_view_sees_has_the_unseen_cost(name):
    given_ = scene(2, 9, 17, 2)
    given_["unseen_cost"] = 0.25
    given_["s"] = np.full((9, 17), 10, np.float32)
    given_["buffers"] = [np.full_like(buffer, 1e6) for buffer in given_["buffers"]]
    np.testing.assert_array_equal(load(name).propagate(**given_).cost, np.float32(0.25))


@everything
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"slope_u": np.zeros((8, 9))}, "slope_u must have the shape (9, 17), not (8, 9)"),
        ({"views": np.zeros((3, 39))}, "views must have the shape (2, 39), not (3, 39)"),
        ({"buffers": []}, "buffers must be 2, as the images are, not 0"),
        ({"images": []}, "propagation needs at least one auxiliary image"),
        ({"candidates": 9}, "candidates must be 1 to 8, not 9"),
        ({"floor": 0.0}, "floor must be positive, not 0.0"),
        ({"separation": -1.0}, "separation must be positive, not -1.0"),
        ({"unseen_cost": 2.0}, "unseen_cost must be 0 to 1, not 2.0"),
        ({"tolerance": np.nan}, "tolerance must not be negative, not nan"),
        (
            {"offsets": np.zeros((4, 3), int)},
            "offsets must have the shape (m, 2) with m of at most 254, not (4, 3)",
        ),
        ({"offsets": np.zeros((4, 2))}, "offsets must be integers, not float64"),
        ({"offsets": np.array([[0, -40000]])}, "offsets must be at most 32767 px, not 40000"),
        ({"active": np.zeros((9, 17))}, "active must be uint8 or bool (9, 17), not float64 (9, 17)"),
        (
            {"large_jump": 1e9},
            "jumps must be 0 <= small_jump and 0 <= large_jump <= 100, not 0.2 and 1000000000.0",
        ),
    ],
)
def test_bad_input_is_named(name, change, message):
    with pytest.raises(KernelError) as error:
        load(name).propagate(**scene(2, 9, 17, 2) | change)
    assert str(error.value) == message
