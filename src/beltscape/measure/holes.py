"""Heights for cells that were not measured, from the rims of their holes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

_REPOSE = np.tan(np.deg2rad([45.0, 60.0]))
"""Heaped material lies no steeper than its angle of repose, some 40°: a steeper rise across a hole is the edge
of something that hid what lies behind it."""
_PINHOLE = np.tan(np.deg2rad([70.0, 80.0]))
"""Between the points of neighbouring pixels a visible face may rise as steeply as one can see at all."""
_DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))


@dataclass(frozen=True, slots=True, eq=False)
class Filled:
    """A field without holes."""

    value_mm: NDArray[np.float64]
    """(Ny, Nx) measured values, and interpolated ones in the holes."""
    sigma_mm: NDArray[np.float64]
    """(Ny, Nx) one standard deviation; in the holes from the relief of the rim."""
    hole: NDArray[np.bool_]
    """(Ny, Nx) what was not measured."""


def fill_holes(
    value_mm: NDArray[np.float64], sigma_mm: NDArray[np.float64], pinhole: NDArray[np.bool_], cell_mm: float
) -> Filled:
    """Fill the NaN cells of a field (Ny, Nx) of heights over the belt.

    Each hole cell looks along four lines through it to the rim on both sides. On a gentle rise it takes the
    straight line between the two rims; across a steep one it takes the lower rim, for what is hidden lies
    behind and below what hides it, and the lines that are not steep then do not count. The four lines are
    averaged, short ones counting more. Beyond the outermost
    measured cells the nearest ones continue.

    σ joins the disagreement of the lines, the steep rises left open (uniform from the lower rim up to the
    straight line), and the rims' own σ. ``pinhole`` (Ny, Nx) are the gaps between points of neighbouring pixels.
    """
    hole = ~np.isfinite(value_mm)
    if hole.all():
        raise ValueError("nothing to interpolate from")
    if not hole.any():
        return Filled(value_mm, sigma_mm, hole)
    rim = _calmed(value_mm, hole)
    limits = np.where(pinhole[hole], _PINHOLE[:, None], _REPOSE[:, None])
    lines = [_line(rim, hole, direction, cell_mm, limits) for direction in _DIRECTIONS]
    guess, spread, weight, steep = (np.stack(each) for each in zip(*lines, strict=True))
    # a shadow is crossed where the rise is steep; along it lines run from one hiding thing to the next
    weight = weight * (1 - steep.max(axis=0) * (1 - steep))
    total = weight.sum(axis=0)
    reached = total > 0
    part = weight / np.where(reached, total, 1)
    mean = np.sum(part * guess, axis=0)
    variance = np.sum(part * (guess - mean) ** 2, axis=0)
    # what only one rim tells anything of lies outside: there the load may be any that is seen elsewhere
    outside = (weight * np.isfinite(spread)).sum(axis=0) == 0
    variance = np.where(outside, float(np.nanvar(value_mm)), np.nansum(part * spread**2, axis=0) + variance)
    typical = float(np.nanmedian(sigma_mm))
    value, sigma = value_mm.copy(), sigma_mm.copy()
    cells = np.nonzero(hole)
    value[cells] = np.where(reached, mean, np.nan)
    sigma[cells] = np.sqrt(np.where(reached, variance, 0.0) + typical**2)
    lost = ~np.isfinite(value)
    if lost.any():
        value, sigma = _continued(value, sigma, lost)
    return Filled(value, sigma, hole)


def _calmed(value: NDArray[np.float64], hole: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Rim cells replaced by the median of the measured cells about them: one flying pixel moves no hole."""
    rows, columns = np.nonzero(np.asarray(ndimage.binary_dilation(hole), bool) & ~hole)
    padded = np.pad(value, 1, constant_values=np.nan)
    around = np.stack([padded[rows + i, columns + j] for i in range(3) for j in range(3)])
    around.sort(axis=0)  # NaN goes last
    number = np.isfinite(around).sum(axis=0)
    calm = value.copy()
    pick = np.arange(len(rows))
    calm[rows, columns] = 0.5 * (around[(number - 1) // 2, pick] + around[number // 2, pick])
    return calm


def _line(
    rim: NDArray[np.float64],
    hole: NDArray[np.bool_],
    direction: tuple[int, int],
    cell_mm: float,
    limits: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Guess, its σ (NaN: only one rim), weight and steepness 0..1 of every hole cell, from the rims beside it."""
    length = cell_mm * np.hypot(*direction)
    near, near_steps = (part[hole] for part in _first_hit(rim, direction))
    far, far_steps = (part[hole] for part in _first_hit(rim, (-direction[0], -direction[1])))
    near_mm, far_mm = near_steps * length, far_steps * length
    both = np.isfinite(near) & np.isfinite(far)
    with np.errstate(invalid="ignore"):
        rise = np.abs(near - far)
        straight = (near * far_mm + far * near_mm) / (near_mm + far_mm)
        steep = np.clip((rise / (near_mm + far_mm) - limits[0]) / (limits[1] - limits[0]), 0, 1)
        steep = np.where(both, steep, 0.0)
        below = straight - np.fmin(near, far)
        between = straight - steep * below
    one_mm = np.where(np.isfinite(near), near_mm, far_mm)
    one = np.where(np.isfinite(near), near, far)
    guess = np.where(both, between, np.nan_to_num(one))
    spread = np.where(both, steep * below / np.sqrt(12), np.nan)
    # a line that found only one rim cannot tell a slope: it counts little
    weight = np.where(both, 1 / (near_mm + far_mm) ** 2, np.where(np.isfinite(one), 0.01 / one_mm**2, 0.0))
    return guess, spread, weight, steep


def _first_hit(
    rim: NDArray[np.float64], direction: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Value of the first measured cell against ``direction`` and the steps to it, for every cell (Ny, Nx)."""
    if direction[0] == 0:
        value, steps = _first_hit(rim.T, (direction[1], 0))
        return value.T, steps.T
    if direction[0] < 0:
        value, steps = _first_hit(rim[::-1, ::-1], (1, -direction[1]))
        return value[::-1, ::-1], steps[::-1, ::-1]
    value, steps = rim.copy(), np.where(np.isfinite(rim), 0.0, np.inf)
    shift = direction[1]
    target = slice(max(shift, 0), rim.shape[1] + min(shift, 0))
    source = slice(max(-shift, 0), rim.shape[1] + min(-shift, 0))
    for row in range(1, len(rim)):
        empty = np.isinf(steps[row, target])
        value[row, target] = np.where(empty, value[row - 1, source], value[row, target])
        steps[row, target] = np.where(empty, steps[row - 1, source] + 1, steps[row, target])
    return value, steps


def _continued(
    value: NDArray[np.float64], sigma: NDArray[np.float64], lost: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The nearest known cell's value, with the whole field's relief as its σ."""
    nearest = ndimage.distance_transform_edt(lost, return_distances=False, return_indices=True)
    assert isinstance(nearest, np.ndarray)
    relief = float(np.std(value[~lost]))
    return value[tuple(nearest)], np.where(lost, np.hypot(sigma, relief), sigma)
