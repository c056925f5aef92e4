"""NumPy's functions of arrays on the device: the emulated GPU gives what NumPy gives, in one launch for a chain."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.kernels import Kernels
from beltscape.kernels.cuda.backend import CudaBackend
from beltscape.kernels.cuda.emulated_device import EmulatedDevice, is_emulation_built
from beltscape.kernels.expressions import MOST_LENGTH, OPERATIONS
from beltscape.kernels.native import NativeBackend, levels
from beltscape.kernels.resident import ResidentArray, as_host
from tests.strategies import seeds

pytestmark = pytest.mark.skipif(not is_emulation_built(), reason="the emulated GPU is not built")

ULPS = 5
"""Of logarithms, exponentials and powers: NumPy's vectors have up to 3.8 and the emulation's library 1."""


class Counting(EmulatedDevice):
    """A device that lists its launches."""

    def __init__(self, seed: int = 0) -> None:
        super().__init__(seed)
        self.launched: list[str] = []

    def launch(self, stream, kernel, grid, block, arguments, shared_bytes):
        self.launched.append(kernel)
        super().launch(stream, kernel, grid, block, arguments, shared_bytes)


def resident(device: EmulatedDevice | None = None) -> tuple[Kernels, CudaBackend]:
    backend = CudaBackend(device or EmulatedDevice(1), NativeBackend(levels()[-1]))
    return Kernels(backend.resident), backend


def compute(array: Any) -> None:
    """Let the device compute an array."""
    array.on_device(lambda _: pytest.fail("nothing is uploaded"))


def plane(seed: int, shape: tuple[int, ...] = (5, 7)) -> np.ndarray:
    """Numbers of both signs with NaN, infinities and zeros among them."""
    rng = np.random.default_rng(seed)
    values = rng.normal(0, 3, shape).astype(np.float32)
    for special in (np.nan, np.inf, -np.inf, 0, -0.0, 1):
        values[rng.random(shape) < 0.06] = special
    return values


def assert_close(found, expected: np.ndarray) -> None:
    found = np.asarray(found)
    assert (found.dtype, found.shape) == (expected.dtype, expected.shape)
    if expected.dtype != np.float32:
        np.testing.assert_array_equal(found, expected)
        return
    with np.errstate(invalid="ignore"):
        off = np.abs(found.astype(float) - expected) <= ULPS * np.spacing(np.abs(expected))
    assert (off | (found == expected) | (np.isnan(found) & np.isnan(expected))).all()


@pytest.mark.parametrize("function", [*OPERATIONS], ids=lambda function: function.__name__)
@given(seeds)
def test_each_function_is_numpys(function, seed):
    kernels, backend = resident()
    operands = [plane(seed + i) for i in range(function.nin)]
    if function in (np.logical_and, np.logical_or, np.logical_not):
        operands = [operand > 0 for operand in operands]
    if function is np.power:
        operands = [np.abs(operands[0]), 3.0]
    given_ = [kernels.keep(each) if isinstance(each, np.ndarray) else each for each in operands]
    found = function(*given_)
    assert isinstance(found, ResidentArray)
    with np.errstate(all="ignore"):
        assert_close(found, function(*operands))
    assert backend.traffic.downloads == 1


@given(
    seeds,
    st.sampled_from(
        [
            ((5, 7), (5, 7)),
            ((5, 7), (1, 7)),
            ((5, 1), (5, 7)),
            ((7,), (5, 7)),
            ((7,), (7,)),
            ((2, 3, 4), (2, 3, 4)),
        ]
    ),
)
def test_operands_are_broadcast(seed, shapes):
    kernels, _ = resident()
    one, other = plane(seed, shapes[0]), plane(seed + 1, shapes[1])
    with np.errstate(all="ignore"):
        assert_close(kernels.keep(one) - kernels.keep(other) * 2, one - other * 2)
        assert_close(one - kernels.keep(other), one - other)
        assert_close(
            np.where(kernels.keep(one) > 0, other, np.float32(np.nan)),
            np.where(one > 0, other, np.float32(np.nan)),
        )
        assert_close(kernels.keep(other).clip(-1, 2), other.clip(-1, 2))


@given(seeds, st.integers(1, 60))
def test_a_chain_of_any_length_is_that_of_numpy(seed, length):
    rng = np.random.default_rng(seed)
    kernels, _ = resident()
    given_ = [plane(seed + i) for i in range(3)]
    found, expected = [kernels.keep(each) for each in given_], list(given_)
    exact = (np.add, np.subtract, np.multiply, np.maximum, np.minimum, np.fmax)
    for _ in range(length):
        function, (i, j) = exact[rng.integers(len(exact))], rng.integers(0, 3, 2)
        with np.errstate(all="ignore"):
            expected[i], found[i] = function(expected[i], expected[j]), function(found[i], found[j])
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(np.asarray(one), other)


def test_a_chain_is_one_launch_and_a_longer_one_few():
    device = Counting()
    kernels, backend = resident(device)
    kept = kernels.keep(plane(0))
    found = np.log(np.minimum(np.abs(kept - 3), 2) + np.float32(0.01)) * 0.5
    assert not device.launched
    compute(found)
    assert device.launched == ["evaluate_floats"]
    for _ in range(3 * MOST_LENGTH):
        kept = kept + 1
    compute(kept)
    assert 3 < len(device.launched) < 12
    assert not backend.traffic.downloads


def test_bytes_wrap_around_as_numpys_do():
    kernels, _ = resident()
    values = np.arange(256, dtype=np.uint8).reshape(16, 16)
    kept = kernels.keep(values)
    for found, expected in (
        (kept + 9, values + 9),
        (kept - kept[::-1], values - values[::-1]),
        (np.maximum(kept, 200) - kept, np.maximum(values, 200) - values),
        (kept == 7, values == 7),
        (kept.astype(np.float32) / 4, values.astype(np.float32) / 4),
        ((kept > 100) & ~(kept > 200), (values > 100) & ~(values > 200)),
        ((kept > 100).astype(np.uint8), (values > 100).astype(np.uint8)),
        ((kept * np.float32(1.5)).astype(np.uint8)[:8], (values * np.float32(1.5)).astype(np.uint8)[:8]),
    ):
        assert_close(found, expected)


def test_what_the_device_lacks_is_computed_by_the_processor():
    kernels, _ = resident()
    values = plane(3)
    kept = kernels.keep(values)
    for found, expected in (
        (np.arctan(kept), np.arctan(values)),
        (kept * np.float64(2), values * np.float64(2)),
        (np.nanmax(kept), np.nanmax(values)),
        (np.add.reduce(kept), np.add.reduce(values)),
        (np.concatenate([kept, values]), np.concatenate([values, values])),
        (kept[:, ::2], values[:, ::2]),
        (kept[kept > 0], values[values > 0]),
    ):
        assert not isinstance(found, ResidentArray)
        np.testing.assert_array_equal(found, expected)


def test_arrays_like_another_are_made_on_the_device():
    kernels, backend = resident()
    kept = kernels.keep(plane(4))
    assert_close(np.full_like(kept, 2.5), np.full((5, 7), 2.5, np.float32))
    assert_close(np.zeros_like(kept, dtype=np.uint8), np.zeros((5, 7), np.uint8))
    assert_close(np.broadcast_to(kept[None, 0], (3, 7)), np.broadcast_to(plane(4)[0], (3, 7)))
    assert_close(np.ones_like(kept), np.ones((5, 7), np.float32))
    assert backend.traffic.uploaded_bytes < 2 * plane(4).nbytes


def test_out_makes_a_result_another_and_leaves_what_was_computed_from_it():
    kernels, _ = resident()
    values = plane(5)
    kept = kernels.keep(values)
    first = kept + 1
    second = first * 2
    same = np.minimum(first, 0, out=first)
    first += 1
    assert same is first
    with np.errstate(all="ignore"):
        assert_close(first, np.minimum(values + 1, 0) + 1)
        assert_close(second, (values + 1) * 2)
    with pytest.raises(TypeError):
        kept += 1
    with pytest.raises(TypeError):
        np.greater(first, 1, out=first)
    own = np.zeros((5, 7), np.float32)
    own += first
    assert_close(own, np.asarray(first))
    with pytest.raises(TypeError):
        first[0] = 1


def test_an_array_of_the_processor_may_change_after_an_expression_has_taken_it():
    kernels, _ = resident()
    values, own = plane(6), plane(7)
    found = kernels.keep(values) + own
    expected = values + own
    own[:] = 0
    assert_close(found, expected)


def test_values_at_pixels_are_gathered_on_the_device():
    kernels, backend = resident()
    values = plane(8)
    mask = values > 0
    kept, (rows, columns) = kernels.keep(values), kernels.list_pixels(kernels.keep(mask))
    down = backend.traffic.downloaded_bytes
    found, flags = kept[rows, columns], (kept > 1)[rows, columns]
    assert backend.traffic.downloaded_bytes == down
    count = np.count_nonzero(mask)
    assert_close(np.asarray(found)[:count], values[mask])
    assert np.asarray(flags).astype(bool)[:count].tolist() == (values > 1)[mask].tolist()
    assert as_host((rows, columns))[0][:count].tolist() == np.nonzero(mask)[0].tolist()


def test_rows_of_an_expression_and_one_more_axis_are_expressions():
    device = Counting()
    kernels, _ = resident(device)
    several, row, column = plane(9), plane(10)[0], plane(11)[:, :1]

    def compute(x, y, z):
        all_rows = np.maximum(np.abs(x) + y, 2) * z + np.ones((5, 1), np.float32)
        return [*all_rows, (all_rows[3] - y).reshape(1, -1)]

    found = compute(*map(kernels.keep, (several, row, column)))
    assert not device.launched
    with np.errstate(all="ignore"):
        expected = compute(several, row, column)
    for one, other in zip(found, expected, strict=True):
        assert_close(one, other)
    assert device.launched == ["evaluate_floats"] * 6


@given(seeds)
def test_pixels_are_put_on_an_expression_as_on_its_result(seed):
    kernels, values = resident()[0], plane(seed)
    kept, pixels = kernels.keep(values), kernels.list_pixels(kernels.keep(values > 1))
    base, new = np.minimum(kept, 0.5), kernels.keep(np.full(pixels[0].shape, 7, np.float32))
    found = kernels.put_pixels(base, pixels, new)
    assert_close(found, np.where(values > 1, np.float32(7), np.minimum(values, np.float32(0.5))))
    assert_close(base, np.minimum(values, np.float32(0.5)))
    again = kernels.put_pixels(kernels.keep(base), pixels, new)
    np.testing.assert_array_equal(np.asarray(again), np.asarray(found))
