"""Windows and lists of pixels: the emulated GPU agrees with OpenCV and NumPy; input that does not fit is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import KernelError
from beltscape.kernels import load
from beltscape.kernels.cuda.planes import MOST_DISTANCE_PX
from beltscape.kernels.native import levels
from beltscape.kernels.planes import blur, dilate, erode, measure_distances, median_blur
from tests.kernels.grids import WIDTHS
from tests.kernels.planes.test_expressions import resident
from tests.kernels.rounding import emulated
from tests.strategies import seeds

every = pytest.mark.parametrize("name", [levels()[-1], *emulated()])
sizes = st.sampled_from(WIDTHS)
sides = st.sampled_from((1, 3, 5, 7, 9, 31))


def plane(seed: int, height: int, width: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(100, 30, (height, width)).astype(np.float32)


def mask(seed: int, height: int, width: int, share: float = 0.05) -> np.ndarray:
    return np.random.default_rng(seed).random((height, width)) < share


@every
@given(seeds, sizes, sizes, sides, sides, st.booleans())
def test_means_are_opencvs(name, seed, height, width, columns, rows, repeat):
    given_ = plane(seed, height, width), (columns, rows)
    expected = load("reference").average_windows(*given_, repeat_edge=repeat)
    found = load(name).average_windows(*given_, repeat_edge=repeat)
    assert found.dtype == np.float32
    np.testing.assert_array_max_ulp(found, expected, 1)


@every
@given(seeds, sizes, sizes, sides, sides, st.booleans())
def test_moments_are_those_of_means_of_squares(name, seed, height, width, columns, rows, repeat):
    values, kernels = plane(seed, height, width), load(name)
    mean, square = (
        kernels.average_windows(x, (columns, rows), repeat_edge=repeat) for x in (values, values * values)
    )
    found = kernels.measure_moments(values, (columns, rows), repeat_edge=repeat)
    assert found[0].tobytes() == mean.tobytes()
    assert found[1].tobytes() == np.maximum(square - mean * mean, 0).tobytes()


@every
@given(seeds, sizes, sizes, sides, sides, st.booleans())
def test_extremes_and_medians_are_opencvs(name, seed, height, width, columns, rows, largest):
    values = plane(seed, height, width)
    for found, expected in (
        (k.find_extremes(values, (columns, rows), largest=largest) for k in (load(name), load("reference"))),
        (k.median_of_windows(values) for k in (load(name), load("reference"))),
    ):
        np.testing.assert_array_equal(found, expected)


@every
@given(seeds, sizes, sizes, st.sampled_from((0.002, 0.05, 0.5)))
def test_distances_are_opencvs_up_to_where_the_search_ends(name, seed, height, width, share):
    marked = mask(seed, height, width, share).astype(np.uint8)
    marked[0, 0] = 1
    found, expected = (k.measure_distances(marked) for k in (load(name), load("reference")))
    np.testing.assert_allclose(found, np.minimum(expected, MOST_DISTANCE_PX), rtol=3e-6)


def test_the_search_for_a_mask_ends():
    kernels, _ = resident()
    nothing = np.zeros((1, 300), bool)
    assert (np.asarray(measure_distances(kernels.keep(nothing))) == MOST_DISTANCE_PX).all()
    nothing = np.eye(1, 300, dtype=bool)
    found = np.asarray(measure_distances(kernels.keep(nothing)))[0]
    assert found.tolist() == [min(x, MOST_DISTANCE_PX) for x in range(300)]


@every
@given(seeds, sizes, sizes, sizes, sizes)
def test_resolutions_change_as_opencvs_do(name, seed, height, width, less, less_wide):
    values = plane(seed, height, width)
    size = min(width, less_wide), min(height, less)
    for kernel, to in (("average_areas", size), ("interpolate_plane", (2 * width + less, height + 3))):
        found, expected = (getattr(load(each), kernel)(values, to) for each in (name, "reference"))
        assert found.shape == to[::-1]
        np.testing.assert_allclose(found, expected, rtol=2e-5)


@every
@pytest.mark.parametrize(("width", "height"), [(7, 5), (16, 9), (19, 16), (76, 64), (1, 1), (48, 3)])
def test_means_over_areas_that_are_no_whole_pixels_have_the_bits_of_opencvs(name, width, height):
    values = plane(3, 67, 79)
    found, expected = (load(each).average_areas(values, (width, height)) for each in (name, "reference"))
    np.testing.assert_array_equal(found, expected)


@every
@given(seeds, sizes, sizes, st.integers(1, 5), st.integers(0, 4))
def test_blocks_are_averaged_and_repeated_and_planes_subsampled(name, seed, height, width, step, more):
    kernels, reference = load(name), load("reference")
    values = plane(seed, height + step, width + step)
    found, expected = (k.average_blocks(values, step) for k in (kernels, reference))
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    shape = step * values.shape[0] + more, step * values.shape[1] + more
    found, expected = (k.repeat_blocks(values, step, shape) for k in (kernels, reference))
    np.testing.assert_array_equal(found, expected)
    first = step // 2
    found = kernels.subsample_plane(values, first, step)
    np.testing.assert_array_equal(found, values[first::step, first::step])


@every
@given(seeds, sizes, sizes, st.sampled_from((0.0, 0.1, 1.0)))
def test_pixels_are_listed_put_back_and_numbered(name, seed, height, width, share):
    kernels, marked = load(name), mask(seed, height, width, share)
    rows, columns = kernels.list_pixels(marked)
    expected = np.nonzero(marked)
    count = len(expected[0])
    assert (rows[:count].tolist(), columns[:count].tolist()) == (expected[0].tolist(), expected[1].tolist())
    assert count <= len(rows) <= count + max(7, count // 8), "rounded up"
    repeated = set(zip(rows[count:].tolist(), columns[count:].tolist(), strict=True))
    assert repeated <= {(rows[0], columns[0])} if count else not repeated
    values = np.append(np.arange(count, dtype=np.float32), np.zeros(len(rows) - count, np.float32))
    changed = plane(seed, height, width)
    found = kernels.put_pixels(changed.copy(), (rows, columns), values)
    changed[expected] = values[:count]
    np.testing.assert_array_equal(found, changed)
    accepted = mask(seed + 1, height, width, 0.5)
    addresses = kernels.assign_addresses((rows, columns), accepted, 2)
    numbered = accepted.astype(np.int32)
    numbered[expected] = np.arange(2, 2 + count)
    np.testing.assert_array_equal(addresses, numbered)


@every
@given(seeds, st.integers(1, 9), sizes, st.integers(1, 4))
def test_the_first_of_the_best_candidates_is_picked(name, seed, candidates, pixels, count):
    rng = np.random.default_rng(seed)
    scores = rng.integers(-2, 2, (candidates, pixels)).astype(np.float32)
    scores[rng.random(scores.shape) < 0.2] = -np.inf
    planes = [rng.normal(size=scores.shape).astype(np.float32) for _ in range(count)]
    best = scores.argmax(axis=0)
    found = load(name).pick_best(scores, planes)
    np.testing.assert_array_equal(found, [each[best, np.arange(pixels)] for each in planes])


@every
def test_what_does_not_fit_is_refused(name):
    kernels, values = load(name), np.zeros((3, 4), np.float32)
    with pytest.raises(KernelError, match="windows must have odd sides, not 2 × 3"):
        kernels.average_windows(values, (2, 3))
    with pytest.raises(KernelError, match=r"plane must have the shape \(H, W\), not \(3,\)"):
        kernels.median_of_windows(values[:, 0])
    with pytest.raises(KernelError, match=r"mask must be uint8 or bool"):
        kernels.measure_distances(values)


def test_functions_of_planes_compute_where_the_plane_is():
    kernels, backend = resident()
    values, marked = plane(1, 9, 11), mask(2, 9, 11).astype(np.uint8)
    kept = kernels.keep(values)
    found = blur(kept, (3, 3)), dilate(kept, (3, 3)), erode(kernels.keep(marked), (5, 5)), median_blur(kept)
    assert not backend.traffic.downloads
    expected = blur(values, (3, 3)), dilate(values, (3, 3)), erode(marked, (5, 5)), median_blur(values)
    for one, other in zip(found, expected, strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_allclose(one, other, rtol=1e-6)
