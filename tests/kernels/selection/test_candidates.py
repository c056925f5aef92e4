"""Candidates and photo-consistency: each level agrees with the reference; properties of any surface."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.native import levels
from beltscape.kernels.selection import CANDIDATES
from tests.kernels.grids import STRAIGHT, WIDTHS, surface, texture, view_of_seed
from tests.kernels.rounding import emulated, first_alike
from tests.strategies import seeds
from tests.thorough import examples

every_level = pytest.mark.parametrize("level", (*levels(), *emulated()))
everything = pytest.mark.parametrize("name", ["reference", *levels(), *emulated()])
sizes = st.sampled_from(WIDTHS)


def field(seed: int, height: int, width: int, count: int) -> dict[str, Any]:
    """Input of `candidate_surfaces`: a rough surface with holes, half of it reliable, pixels at random."""
    rng = np.random.default_rng(seed)
    slopes = rng.normal(0, 0.8, (2, height, width)).astype(np.float32)
    slopes[rng.random(slopes.shape) < 0.05] = np.nan
    return {
        "s": surface(seed, height, width),
        "slope_u": slopes[0],
        "slope_v": slopes[1],
        "reliable": rng.random((height, width)) < 0.5,
        "u": rng.integers(0, width, count),
        "v": rng.integers(0, height, count),
    }


def cameras(seed: int, height: int, width: int, views: int) -> dict[str, Any]:
    """What the cameras see: unrelated textures, buffers of another surface, gains about 1."""
    rng = np.random.default_rng(seed)
    rows = np.stack([view_of_seed(seed + i) for i in range(views)])
    shapes = [(30 + 9 * i, 40 - 3 * i) for i in range(views)]
    return {
        "core": texture(seed, height, width),
        "variance": rng.uniform(1, 2000, (height, width)),
        "images": [texture(seed + i, h, w) for i, (w, h) in enumerate(shapes)],
        "views": rows,
        "buffers": load("reference").inverse_depth_buffers(surface(seed + 1, height, width), rows, shapes),
        "gains": [rng.uniform(0.7, 1.3, (height, width)) for _ in range(views)],
        "tolerance": 1.0,
    }


@every_level
@given(seeds, sizes, sizes, st.integers(1, 40), st.integers(1, 9))
def test_native_candidates_equal_the_reference(level, seed, height, width, count, reach):
    given_ = field(seed, height, width, count)
    expected = load("reference").candidate_surfaces(**given_, reach=reach, separation=1.0)
    found = load(level).candidate_surfaces(**given_, reach=reach, separation=1.0, threads=2)
    for name in ("s", "slope_u", "slope_v", "distance"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-5, atol=1e-4)
    apart = np.abs(expected.s[:, None] - expected.s[None])
    clear = ~(np.abs(apart - 1) < 1e-3).any(axis=1)  # nobody stands where float32 may decide otherwise
    np.testing.assert_allclose(found.support[clear], expected.support[clear], atol=1e-5)


@every_level
@examples(40)
@given(seeds, sizes, sizes, st.integers(1, 40), st.integers(1, 4))
def test_native_photo_consistency_agrees_with_the_reference(level, seed, height, width, count, views):
    there = field(seed, height, width, count)
    u, v = there["u"], there["v"]
    planes = load("reference").candidate_surfaces(**there, reach=5, separation=1.0)
    given_ = cameras(seed, height, width, views)
    expected = load("reference").photo_consistency(u, v, *planes[:3], **given_)
    found = load(level).photo_consistency(u, v, *planes[:3], **given_, threads=2)
    same = found.views == expected.views
    assert (~same).sum() <= 1 + 0.005 * same.size
    for a, b in zip(found, expected, strict=True):
        assert a.dtype == np.float32
        close = np.isclose(a, b, rtol=2e-3, atol=2e-2)
        assert (same & ~close).sum() <= 1 + 0.005 * same.size


@given(seeds, sizes, st.integers(1, 4))
def test_levels_that_round_alike_and_any_threads_give_the_same_bytes(seed, width, threads):
    there, given_ = field(seed, 37, width, 2500), cameras(seed, 37, width, 3)
    for level in (*levels(), *emulated()):
        first = load(first_alike(level))
        planes = first.candidate_surfaces(**there, reach=6, separation=1.0, threads=1)
        like = first.photo_consistency(there["u"], there["v"], *planes[:3], **given_, threads=1)
        others = load(level).candidate_surfaces(**there, reach=6, separation=1.0, threads=threads)
        assert [a.tobytes() for a in others] == [a.tobytes() for a in planes]
        others = load(level).photo_consistency(there["u"], there["v"], *planes[:3], **given_, threads=threads)
        assert [a.tobytes() for a in others] == [a.tobytes() for a in like]


@everything
@given(seeds, st.floats(-0.9, 0.9), st.floats(-0.9, 0.9))
def test_on_a_plane_all_candidates_are_equal(name, seed, across, down):
    there = field(seed, 30, 31, 50)
    v, u = np.mgrid[:30, :31]
    there |= {"s": 20 + across * u + down * v, "slope_u": np.full(u.shape, across)}
    there |= {"slope_v": np.full(u.shape, down)}
    found = load(name).candidate_surfaces(**there, reach=7, separation=0.1)
    own = there["s"][there["v"], there["u"]]
    known = np.isfinite(found.s)
    np.testing.assert_allclose(found.s[known], np.broadcast_to(own, found.s.shape)[known], atol=1e-3)
    others = np.where(known, 1 / (1 + found.distance), 0)
    wanted = others[1:].sum(axis=0) - np.concatenate([0 * others[:1], others[1:]])
    np.testing.assert_allclose(found.support[known], wanted[known], rtol=1e-4, atol=1e-4)


@everything
def test_without_reliable_pixels_only_the_own_candidate_remains(name):
    there = field(1, 20, 20, 12)
    there["reliable"] = np.zeros((20, 20), np.uint8)
    found = load(name).candidate_surfaces(**there, reach=20, separation=1.0)
    assert np.isnan(found.s[1:]).all()
    np.testing.assert_array_equal(found.s[0], there["s"][there["v"], there["u"]])
    assert not found.support.any()


@everything
def test_levels_that_match_after_the_gain_do_not_differ(name):
    height, width, shift, gain = 20, 40, 4, 0.8
    image = texture(3, height, width + 10)
    core = gain * image[:, shift : shift + width]
    s = np.full((height, width), float(shift), np.float32)
    buffers = load("reference").inverse_depth_buffers(s, STRAIGHT[None], [(width + 10, height)])
    u, v = np.arange(4, 32), np.full(28, 9)
    planes = np.stack([np.full(28, shift), np.full(28, shift + 3), np.full(28, shift - 3)])
    given_: dict[str, Any] = {
        "core": core,
        "variance": np.full(core.shape, 4.0),
        "images": [image],
        "views": STRAIGHT[None],
        "buffers": buffers,
        "gains": [np.full(core.shape, gain)],
        "tolerance": 1.0,
    }
    true, nearer, farther = (
        np.stack(part)
        for part in zip(
            *load(name).photo_consistency(u, v, planes, 0 * planes, 0 * planes, **given_), strict=True
        )
    )
    assert true[:8].max() < 1e-6
    assert nearer[6].mean() > 5
    assert true[8].tolist() == nearer[8].tolist() == [1.0] * 28
    assert (farther[8] == 0).all()  # something nearer hides it
    assert (farther[:8] == 50).all()


@everything
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"reach": 0}, "reach must be 1 to 1000 steps, not 0"),
        ({"separation": 0.0}, "separation must be positive"),
        ({"u": np.array([0.5])}, "u must be .* integers"),
        ({"u": np.arange(50)}, "u must be 0 to 29, not 0 to 49"),
        ({"v": np.arange(3)}, "v must be .* integers"),
        ({"reliable": np.ones((2, 2), np.uint8)}, "reliable must be uint8 or bool"),
    ],
)
def test_what_does_not_fit_is_refused(name, change, message):
    with pytest.raises(KernelError, match=message):
        load(name).candidate_surfaces(**(field(1, 20, 30, 50) | {"reach": 4, "separation": 1.0} | change))


@everything
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gains": []}, "gains must be 2, as the images are, not 0"),
        ({"tolerance": -1.0}, "tolerance must not be negative"),
        ({"variance": np.ones((3, 3))}, "variance must have the shape"),
    ],
)
def test_cameras_that_do_not_fit_are_refused(name, change, message):
    plane = np.ones((CANDIDATES, 5))
    with pytest.raises(KernelError, match=message):
        load(name).photo_consistency(
            np.arange(5), np.arange(5), plane, plane, plane, **(cameras(1, 20, 30, 2) | change)
        )
