"""The kernels of planes and lists of pixels on the processor, by OpenCV and NumPy: the same for every back end.

The records are those of `planes`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.statistics import compute_quantile
from beltscape.kernels.expressions import FLOAT, ExpressionInput, evaluate_program

Floats = NDArray[np.float32]
Size = tuple[int, int]
"""Width and height."""
_MEDIAN_PX = 5
"""Side of the median's windows."""
_CROSS = np.array([[0, -1, 0], [-1, 4, -1], [0, -1, 0]], np.float32)
"""Second difference over the four neighbours; it is smaller where a value was interpolated."""


def average_windows(given: Any) -> tuple[Floats]:
    """Return the means (H, W)."""
    border = cv2.BORDER_REPLICATE if given.choice else cv2.BORDER_REFLECT_101
    return (np.asarray(cv2.blur(given.plane, given.size, borderType=border), np.float32),)


def measure_moments(given: Any) -> tuple[Floats, Floats]:
    """Return the means and variances (H, W)."""
    border = cv2.BORDER_REPLICATE if given.choice else cv2.BORDER_REFLECT_101
    mean, square = (
        np.asarray(cv2.blur(x, given.size, borderType=border), np.float32)
        for x in (given.plane, given.plane * given.plane)
    )
    square -= mean * mean
    return mean, np.maximum(square, 0, out=square)


def find_extremes(given: Any) -> tuple[Floats]:
    """Return the extremes (H, W)."""
    return (extremes(given.plane, given.size, largest=given.choice),)


def extremes(plane: NDArray[Any], size: Size, *, largest: bool) -> NDArray[Any]:
    """Return the largest or smallest values (H, W) in windows of (width, height), of the plane's own type."""
    window = np.ones(size[::-1], np.uint8)
    return np.asarray((cv2.dilate if largest else cv2.erode)(plane, window), plane.dtype)


def median_of_windows(given: Any) -> tuple[Floats]:
    """Return the medians (H, W)."""
    return (np.asarray(cv2.medianBlur(given.plane, _MEDIAN_PX), np.float32),)


def measure_distances(given: Any) -> tuple[Floats]:
    """Return the distances (H, W); without any pixel in the mask OpenCV's are nearly the largest number."""
    outside = (given.mask == 0).astype(np.uint8)
    return (np.asarray(cv2.distanceTransform(outside, cv2.DIST_L2, 5), np.float32),)


def average_areas(given: Any, size: Size) -> tuple[Floats]:
    """Return the means over areas, (height, width)."""
    return (np.asarray(cv2.resize(given.plane, size, interpolation=cv2.INTER_AREA), np.float32),)


def interpolate_plane(given: Any, size: Size) -> tuple[Floats]:
    """Return the interpolated plane (height, width)."""
    return (np.asarray(cv2.resize(given.plane, size, interpolation=cv2.INTER_LINEAR), np.float32),)


def average_blocks(given: Any) -> tuple[Floats]:
    """Return the means of whole blocks."""
    height, width = (size // given.step for size in given.plane.shape)
    whole = given.plane[: height * given.step, : width * given.step]
    return (np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.float32),)


def repeat_blocks(given: Any, shape: tuple[int, ...]) -> tuple[Floats]:
    """Return the repeated values, of a shape."""
    height, width = (size * given.step for size in given.plane.shape)
    full = cv2.resize(np.asarray(given.plane, np.float32), (width, height), interpolation=cv2.INTER_NEAREST)
    missing = max(0, shape[0] - height), max(0, shape[1] - width)
    full = cv2.copyMakeBorder(full, 0, missing[0], 0, missing[1], cv2.BORDER_REPLICATE)
    return (np.asarray(full, np.float32),)


def subsample_plane(given: Any) -> tuple[Floats]:
    """Return the values of some rows and columns."""
    every = slice(given.first, None, given.step)
    return (np.ascontiguousarray(given.plane[every, every]),)


def list_pixels(given: Any) -> tuple[Floats, Floats, NDArray[np.int32]]:
    """Return rows and columns, of which the first count, and their number (1,); then the first pixel repeated."""
    rows, columns = (index.astype(np.float32) for index in np.nonzero(given.mask))
    count = len(rows)
    beyond = min(count // 8 + 8, given.mask.size - count) if count else 0
    rows, columns = (np.append(index, np.repeat(index[:1], beyond)) for index in (rows, columns))
    return rows, columns, np.array([count], np.int32)


def _mask_first(rows: Floats, columns: Floats) -> NDArray[np.bool_]:
    """Return the mask (N,) of a list's pixels without the repetitions of its first."""
    once = (rows != rows[:1]) | (columns != columns[:1])
    once[:1] = True
    return once


def put_pixels(given: Any, shape: tuple[int, ...]) -> tuple[Floats]:
    """Return the plane (H, W) with the values."""
    is_program = isinstance(given.plane, ExpressionInput)
    plane = evaluate_program(given.plane, shape, FLOAT) if is_program else given.plane.copy()
    once = _mask_first(given.rows, given.columns)
    plane[given.rows[once].astype(int), given.columns[once].astype(int)] = given.values[once]
    return (plane,)


def assign_addresses(given: Any) -> tuple[NDArray[np.int32]]:
    """Return the addresses (H, W)."""
    addresses = (given.accepted != 0).astype(np.int32)
    once = _mask_first(given.rows, given.columns)
    places = given.rows[once].astype(int), given.columns[once].astype(int)
    addresses[places] = np.flatnonzero(once) + given.first
    return (addresses,)


def pick_best(given: Any) -> tuple[Floats]:
    """Return the values (K, N)."""
    best = given.scores.argmax(axis=0)
    pixels = np.arange(given.scores.shape[1])
    return (np.stack([plane[best, pixels] for plane in given.planes]),)


def filter_plane(given: Any) -> tuple[Floats]:
    """Return the sums (H, W) over windows with weights."""
    border = cv2.BORDER_REPLICATE if given.is_repeated else cv2.BORDER_REFLECT_101
    return (np.asarray(cv2.filter2D(given.plane, cv2.CV_32F, given.weights, borderType=border), np.float32),)


def find_quantile(given: Any) -> tuple[Floats]:
    """Return the quantile () of what is not NaN."""
    numbers = np.concatenate(given.arrays)
    numbers = numbers[~np.isnan(numbers)]
    return (np.asarray(compute_quantile(numbers, given.share), np.float32),)


def average_plane(given: Any) -> tuple[Floats]:
    """Return the mean () of what is finite."""
    numbers = given.plane[np.isfinite(given.plane)]
    return (np.asarray(numbers.mean(dtype=np.float64) if numbers.size else 0, np.float32),)


def measure_phases(given: Any) -> tuple[Floats]:
    """Return the means (4,) of the phases' absolute second differences."""
    height, width = (side // 2 * 2 for side in given.image.shape)
    difference = np.abs(cv2.filter2D(given.image, -1, _CROSS))[:height, :width]
    return (np.array([difference[y::2, x::2].mean() for y in (0, 1) for x in (0, 1)], np.float32),)


_OF_SIZE = {"average_areas": average_areas, "interpolate_plane": interpolate_plane}
_OF_RECORD = {
    function.__name__: function
    for function in (
        average_windows, measure_moments, find_extremes, median_of_windows, measure_distances, average_blocks,
        subsample_plane, list_pixels, assign_addresses, pick_best, filter_plane, find_quantile, average_plane,
        measure_phases,
    )
}  # fmt: skip
_OF_SHAPE = {"put_pixels": put_pixels, "repeat_blocks": repeat_blocks}
KERNELS = {*_OF_SIZE, *_OF_SHAPE, *_OF_RECORD, "evaluate_expression"}
"""Names of the kernels that are here."""


def run(kernel: str, given: Any, out: Sequence[NDArray[Any]]) -> Sequence[NDArray[Any]]:
    """Return the results of a kernel by its name; of ``out`` only shape and type count."""
    shape = out[0].shape
    if kernel == "evaluate_expression":
        return (evaluate_program(given, shape, out[0].dtype),)
    if kernel in _OF_SHAPE:
        return _OF_SHAPE[kernel](given, shape)
    if kernel in _OF_SIZE:
        return _OF_SIZE[kernel](given, (shape[1], shape[0]))
    return _OF_RECORD[kernel](given)
