"""The continuation of a measured surface into holes, in the reference back end (kernels/holes.py)."""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.holes import (
    CONTINUED_ALONG,
    CONTINUED_CELLS,
    LOGIT,
    MOST_CELLS,
    PLANE_CELLS,
    STEEPEST,
    SUPPORT_CELLS,
    ContinuationInput,
)


def continue_surface(given: ContinuationInput) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return heights and probabilities (H,)."""
    row, column = np.nonzero(~np.isfinite(given.field[given.first : given.end]))
    reach = CONTINUED_CELLS
    field = np.pad(given.field / given.cell, reach, constant_values=np.nan)  # no line leaves it
    start = (row + given.first + reach) * field.shape[1] + column + reach
    heights, distances = _predict(field, start)
    logit = _compute_logit(heights, distances)
    best = logit.argmax(axis=0)[None]
    height, most = (np.take_along_axis(each, best, axis=0)[0] for each in (heights, logit))
    return given.cell * height, 1 / (1 + np.exp(-most))


def _predict(
    field: NDArray[np.float64], start: NDArray[np.intp]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (8, N) predictions by the planes at the ends of the lines, and their (8, N) distances.

    ``start`` are the cells' places in the flattened field. Without an end in reach they are NaN and infinite. No
    prediction lies below both the belt and the lowest end.
    """
    heights = np.full((len(CONTINUED_ALONG), len(start)), np.nan)
    distances = np.full(heights.shape, np.inf)
    lowest = np.zeros(len(start))
    by_row, by_column = _fit_rises(field)
    flat, known = field.ravel(), np.isfinite(field).ravel()
    for number, (down, right) in enumerate(CONTINUED_ALONG):
        rise = (down * by_row + right * by_column).ravel()
        waiting, place = np.arange(len(start)), start
        for step in range(1, CONTINUED_CELLS + 1):
            place = place + (down * field.shape[1] + right)
            ends = known[place]
            heights[number, waiting[ends]] = flat[place[ends]] - step * rise[place[ends]]
            distances[number, waiting[ends]] = step * np.hypot(down, right)
            lowest[waiting[ends]] = np.minimum(lowest[waiting[ends]], flat[place[ends]])
            waiting, place = waiting[~ends], place[~ends]
    return np.maximum(heights, lowest), distances


def _fit_rises(field: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the rise per row and per column of planes through the known cells beside holes; 0 elsewhere.

    A plane is fitted to the cells of its surface around the cell. Two level cells of weight one, one on either axis,
    keep a plane level that too few cells determine.
    """
    known = np.isfinite(field)
    beside = cv2.dilate((~known).view(np.uint8), np.ones((3, 3), np.uint8)).view(np.bool_)
    row, column = np.nonzero(known & beside)
    centre = field[row, column]
    xx, xy, yy = (np.full(len(row), start) for start in (1.0, 0.0, 1.0))
    xh, yh = np.zeros(len(row)), np.zeros(len(row))
    around = range(-PLANE_CELLS, PLANE_CELLS + 1)
    for y, x in product(around, around):
        height = field[row + y, column + x] - centre
        own = np.abs(height) <= STEEPEST * max(abs(x), abs(y))
        height = np.where(own, height, 0.0)
        xx += own * (x * x)
        xy += own * (x * y)
        yy += own * (y * y)
        xh += x * height
        yh += y * height
    determinant = xx * yy - xy * xy
    by_row, by_column = np.zeros(field.shape), np.zeros(field.shape)
    by_row[row, column] = (yh * xx - xh * xy) / determinant
    by_column[row, column] = (xh * yy - yh * xy) / determinant
    return by_row, by_column


def _compute_logit(heights: NDArray[np.float64], distances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (8, N) the logit of the probability of each prediction; -inf without one."""
    constant, by_distance, by_support, above, below = LOGIT
    known = np.isfinite(heights)
    lowest, highest = (
        edge(np.where(known, heights, blank), axis=0) for edge, blank in ((np.min, np.inf), (np.max, -np.inf))
    )
    logit = np.full(heights.shape, -np.inf)
    for number, height in enumerate(heights):
        near = np.abs(heights - height) < SUPPORT_CELLS
        near[number] = False
        support = np.where(near, 1 / distances, 0.0).sum(axis=0)
        sum_of_terms = (
            constant
            + by_distance * distances[number]
            + by_support * support
            + above * np.minimum(height - lowest, MOST_CELLS)
            + below * np.minimum(highest - height, MOST_CELLS)
        )
        logit[number] = np.where(known[number], sum_of_terms, -np.inf)
    return logit
