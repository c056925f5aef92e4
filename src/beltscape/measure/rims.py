"""The rims of holes: from every hole cell along lines to the first measured cells on both sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

_LOADED_MM = 5.0
"""What lies no higher is bare belt."""
_WINDOW = 7
"""Cells across the window in which a surface's slope is fitted."""
_DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Rows, columns: along x, along y, both diagonals."""
_TURNS_DEG = (14, 31, 59, 76, 104, 121, 149, 166)
"""And between these, 14° to 17° apart; none of them steps on the border between two cells."""
_LONGEST_CELLS = 96
"""Lines along slots go so far to either side."""


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """A line through every hole cell, (H,) each: its rims on the near side (-) and on the far side (+)."""

    near_mm: NDArray[np.float64]
    """Height of the rim; NaN where none was met."""
    far_mm: NDArray[np.float64]
    near_at_mm: NDArray[np.float64]
    """Distance to it; inf where none was met."""
    far_at_mm: NDArray[np.float64]
    near_slope: NDArray[np.float64]
    """Steepness of the surface at the rim, 0 level."""
    far_slope: NDArray[np.float64]
    near_rise: NDArray[np.float64]
    """Rise over run of the surface at the rim towards the far side."""
    far_rise: NDArray[np.float64]
    slant: NDArray[np.float64]
    """Tangent by which the camera's rays come down towards the far side."""
    upright: NDArray[np.bool_]
    """Where the rays come straight from above, and the camera's own line has no direction."""


@dataclass(frozen=True, slots=True, eq=False)
class Hollows:
    """How uneven a surface is between places some distance apart."""

    apart_mm: NDArray[np.float64]
    """(K,) ascending from 0."""
    rms_mm: NDArray[np.float64]
    """(K,) robust standard deviation of the middle's height over the straight line between two places."""

    def depth_mm(self, gap_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Unevenness (N,) over gaps (N,)."""
        return np.interp(gap_mm, self.apart_mm, self.rms_mm)


@dataclass(frozen=True, slots=True, eq=False)
class Lowest:
    """The line through H hole cells whose higher rim is lowest; inf and NaN where none met rims on both sides."""

    upper_mm: NDArray[np.float64]
    lower_mm: NDArray[np.float64]
    gap_mm: NDArray[np.float64]
    """From rim to rim."""
    nearer: NDArray[np.float64]
    """Share of the gap to its nearer rim, up to a half."""


def hollows(value_mm: NDArray[np.float64], cell_mm: float) -> Hollows:
    """Unevenness of a field (Ny, Nx) of loads, where there is load, at distances that double."""
    apart, rms = [0.0], [0.0]
    half = 1
    while 2 * half < max(value_mm.shape):
        off = []
        for field in (value_mm, value_mm.T):
            middle = field[half:-half]
            if not len(middle):
                continue
            bend = middle - 0.5 * (field[2 * half :] + field[: -2 * half])
            off.append(bend[np.isfinite(bend) & (middle > _LOADED_MM)])
        if len(values := np.concatenate(off)) < 200:
            break
        apart.append(2 * half * cell_mm)
        rms.append(max(rms[-1], 1.4826 * float(np.median(np.abs(values)))))
        half *= 2
    return Hollows(np.array(apart), np.array(rms))


def gradients(value_mm: NDArray[np.float64], cell_mm: float) -> NDArray[np.float64]:
    """(2, Ny, Nx) slope in x and y of the plane fitted to the cells about each; 0 where too few were measured."""
    measured = np.isfinite(value_mm).astype(np.float64)
    z = np.nan_to_num(value_mm)
    k = np.arange(_WINDOW) - _WINDOW // 2
    even, odd, square = np.ones(_WINDOW), k.astype(np.float64), (k * k).astype(np.float64)

    def moment(
        values: NDArray[np.float64], down: NDArray[np.float64], across: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        part = ndimage.correlate1d(values, down, axis=0, mode="constant")
        return np.asarray(ndimage.correlate1d(part, across, axis=1, mode="constant"), np.float64)

    number = np.maximum(moment(measured, even, even), 1.0)
    x, y = moment(measured, even, odd), moment(measured, odd, even)
    total, sum_x, sum_y = moment(z, even, even), moment(z, even, odd), moment(z, odd, even)
    xx = moment(measured, even, square) - x * x / number
    yy = moment(measured, square, even) - y * y / number
    xy = moment(measured, odd, odd) - x * y / number
    xz, yz = sum_x - x * total / number, sum_y - y * total / number
    spread = xx * yy - xy * xy
    sound = (spread > 1e-3 * xx * yy) & (number >= _WINDOW) & (measured > 0)
    spread = np.where(sound, spread, 1.0)
    slope = np.stack([xz * yy - yz * xy, yz * xx - xz * xy]) / spread / cell_mm
    return np.where(sound, slope, 0.0)


def lowest_through(
    lines: list[Line], rim_mm: NDArray[np.float64], hole: NDArray[np.bool_], cell_mm: float
) -> Lowest:
    """Of twelve lines through the hole cells, all around, the one whose higher rim is lowest.

    Along a slot between walls it runs from its one end to its other, where the floor may be seen; ``lines`` are those
    of `lines_through`.
    """
    start, measured = np.nonzero(hole), ~hole
    rims = [(line.near_mm, line.far_mm, line.near_at_mm, line.far_at_mm) for line in lines[1:]]
    for turn_deg in _TURNS_DEG:
        way = np.deg2rad(turn_deg)
        down, across = np.full(len(start[0]), np.sin(way)), np.full(len(start[0]), np.cos(way))
        ends = [_march(measured, start, (sign * down, sign * across), _LONGEST_CELLS) for sign in (-1, 1)]
        height = [np.where(at >= 0, rim_mm.ravel()[at], np.nan) for at, _ in ends]
        rims.append((height[0], height[1], ends[0][1] * cell_mm, ends[1][1] * cell_mm))
    near, far, near_at, far_at = np.array(rims).transpose(1, 0, 2)
    met = np.isfinite(near) & np.isfinite(far)
    upper = np.where(met, np.fmax(near, far), np.inf)
    gap = np.where(met, near_at + far_at, np.inf)
    nearer = np.where(met, np.minimum(near_at, far_at), np.nan) / np.where(met, gap, 1.0)
    lower = np.fmin(near, far)
    # equal lengths are equal in any unit and however they were added up
    cells = np.round(gap / cell_mm, 6)
    own = np.lexsort((np.round(nearer, 9), lower, cells, upper), axis=0)[:1]
    picked = (np.take_along_axis(part, own, axis=0)[0] for part in (upper, lower, gap, nearer))
    return Lowest(*picked)


def lines_through(
    rim_mm: NDArray[np.float64],
    hole: NDArray[np.bool_],
    gradient: NDArray[np.float64],
    lean: NDArray[np.float64],
    cell_mm: float,
) -> list[Line]:
    """Five lines through the hole cells: the camera's own (along ``lean`` (2, Ny, Nx)), then four fixed ones."""
    tan_x, tan_y = lean[0][hole], lean[1][hole]
    tangent = np.hypot(tan_x, tan_y)
    straight_down = tangent < 1e-9
    unit = np.where(straight_down, 1.0, tangent)
    down, across = np.where(straight_down, 0.0, tan_y / unit), np.where(straight_down, 1.0, tan_x / unit)
    start = np.nonzero(hole)

    def line(
        near: tuple[NDArray[np.intp], NDArray[np.float64]],
        far: tuple[NDArray[np.intp], NDArray[np.float64]],
        step_mm: float,
        way: tuple[NDArray[np.float64] | float, NDArray[np.float64] | float],
        slant: NDArray[np.float64],
    ) -> Line:
        height = [np.where(at >= 0, rim_mm.ravel()[at], np.nan) for at, _ in (near, far)]
        x, y = ([np.where(at >= 0, part.ravel()[at], 0.0) for at, _ in (near, far)] for part in gradient)
        steep = [np.hypot(*pair) for pair in zip(x, y, strict=True)]
        rise = [pair[0] * way[1] + pair[1] * way[0] for pair in zip(x, y, strict=True)]
        return Line(*height, near[1] * step_mm, far[1] * step_mm, *steep, *rise, slant, straight_down)

    measured = ~hole
    found = [
        line(
            _march(measured, start, (-down, -across)),
            _march(measured, start, (down, across)),
            cell_mm,
            (down, across),
            tangent,
        )
    ]
    for way in _DIRECTIONS:
        near, far = (
            tuple(part[hole] for part in _swept(measured, toward)) for toward in (way, (-way[0], -way[1]))
        )
        length = float(np.hypot(*way))
        slant = (tan_x * way[1] + tan_y * way[0]) / length
        unit_way = (way[0] / length, way[1] / length)
        found.append(line(near, far, cell_mm * length, unit_way, slant))  # pyright: ignore[reportArgumentType]
    return found


def _swept(measured: NDArray[np.bool_], way: tuple[int, int]) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """For every cell (Ny, Nx) flat index of the first measured cell against ``way``, -1 for none, and the steps."""
    return _swept_index(np.where(measured, np.arange(measured.size).reshape(measured.shape), -1), way)


def _swept_index(
    index: NDArray[np.intp], way: tuple[int, int]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    if way[0] == 0:
        at, steps = _swept_index(index.T, (way[1], 0))
        return at.T, steps.T
    if way[0] < 0:
        at, steps = _swept_index(index[::-1, ::-1], (1, -way[1]))
        return at[::-1, ::-1], steps[::-1, ::-1]
    at, steps = index.copy(), np.where(index >= 0, 0.0, np.inf)
    shift, columns = way[1], index.shape[1]
    target = slice(max(shift, 0), columns + min(shift, 0))
    source = slice(max(-shift, 0), columns + min(-shift, 0))
    for row in range(1, len(index)):
        empty = at[row, target] < 0
        at[row, target] = np.where(empty, at[row - 1, source], at[row, target])
        steps[row, target] = np.where(empty, steps[row - 1, source] + 1, steps[row, target])
    return at, steps


def _march(
    measured: NDArray[np.bool_],
    start: tuple[NDArray[np.intp], NDArray[np.intp]],
    way: tuple[NDArray[np.float64], NDArray[np.float64]],
    longest: int | None = None,
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Flat index of the first measured cell from each start along its own way, -1 for none, and the steps to it."""
    found = np.full(len(start[0]), -1)
    steps = np.full(len(found), np.inf)
    going = np.arange(len(found))
    rows, columns = measured.shape
    at_row, at_column = (part.astype(np.float64) for part in start)
    down, across = way
    for step in range(1, longest or max(measured.shape)):
        at_row, at_column = at_row + down, at_column + across
        row, column = np.rint(at_row).astype(np.intp), np.rint(at_column).astype(np.intp)
        inside = (row >= 0) & (column >= 0) & (row < rows) & (column < columns)
        flat = np.where(inside, row * columns + column, 0)
        met = inside & measured.ravel()[flat]
        found[going[met]], steps[going[met]] = flat[met], step
        on = inside & ~met
        going, at_row, at_column, down, across = (
            part[on] for part in (going, at_row, at_column, down, across)
        )
        if not len(going):
            break
    return found, steps
