"""Correlations and peaks of many patches at a time are those of each by itself."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from beltscape.stereo.consistency.correlation import correlate_closely, correlate_widely, find_peaks
from beltscape.stereo.consistency.residuals import BLOCKS, compute_block_medians

_SIDE = 15


def _draw_pairs(number: int, radius: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return areas of 8-bit levels, and a noisy patch of each at a random position."""
    rng = np.random.default_rng(number)
    width = _SIDE + 2 * radius
    areas = np.stack(
        [cv2.GaussianBlur(rng.uniform(0, 255, (width, width)), (0, 0), 1.2) for _ in range(number)]
    )
    corners = rng.integers(0, 2 * radius + 1, (number, 2))
    patches = [area[v : v + _SIDE, u : u + _SIDE] for area, (u, v) in zip(areas, corners, strict=True)]
    noise = rng.normal(0, 2, (number, _SIDE, _SIDE))
    return areas.astype(np.float32), (np.stack(patches) + noise).astype(np.float32)


def test_close_correlations_are_those_of_opencv() -> None:
    """Also for patches whose level is far from zero."""
    areas, patches = _draw_pairs(40, 1)
    expected = correlate_widely(zip(areas, patches, strict=True))
    assert np.abs(correlate_closely(areas, patches) - expected).max() < 1e-5


def test_a_patch_without_texture_has_no_correlation() -> None:
    """Instead of a division by zero."""
    areas, patches = _draw_pairs(2, 1)
    patches[0] = 7.0
    areas[1] = 9.0
    assert np.abs(correlate_closely(areas, patches)).max() < 1e-3


@pytest.mark.parametrize("radius", [1, 4, 9])
def test_peaks_are_found_one_by_one(radius: int) -> None:
    """A peak needs its value, a lead over what is farther away, and neighbours on all sides."""
    maps = correlate_widely(zip(*_draw_pairs(200, radius), strict=True))
    peaks = find_peaks(maps, 0.7)
    assert 0 < np.isfinite(peaks[:, 0]).sum() < len(peaks)
    for one, peak in zip(maps, peaks, strict=True):
        np.testing.assert_array_equal(_find_peak(one, 0.7), peak)


def _find_peak(one: NDArray[np.float32], least: float) -> tuple[float, float]:
    """Return the peak of one map by its definition."""
    none = float("nan"), float("nan")
    row, column = (int(at) for at in np.unravel_index(one.argmax(), one.shape))
    inner = 0 < row < len(one) - 1 and 0 < column < one.shape[1] - 1
    if one[row, column] < least or not inner:
        return none
    far = one.copy()
    far[max(row - 3, 0) : row + 4, max(column - 3, 0) : column + 4] = -1
    if one.size > 49 and float(far.max()) > float(one[row, column]) - 0.08:
        return none
    across, down = one[row, column - 1 : column + 2], one[row - 1 : row + 2, column]
    return column + _find_vertex(*across.tolist()), row + _find_vertex(*down.tolist())


def _find_vertex(before: float, at: float, after: float) -> float:
    bend = before - 2 * at + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0 else 0.0


def test_no_maps_have_no_peaks() -> None:
    """A camera whose image shows none of the points is searched as well."""
    assert find_peaks(correlate_widely([]), 0.7).shape == (0, 2)


def test_medians_of_blocks_are_those_of_numpy() -> None:
    """Of odd and of even numbers; an empty block has 0."""
    rng = np.random.default_rng(3)
    blocks = rng.integers(0, BLOCKS[0] * BLOCKS[1] - 1, 100)
    values = rng.normal(size=100)
    medians, counts = compute_block_medians(values, blocks)
    assert medians[-1] == counts[-1] == 0
    for block in range(len(counts) - 1):
        own = values[blocks == block]
        assert (medians[block], counts[block]) == (np.median(own), len(own))
    assert not compute_block_medians(np.empty(0), np.empty(0, np.int64))[0].any()
