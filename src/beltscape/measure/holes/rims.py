"""The rims of holes: from every hole cell along lines to the first measured cells on both sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.measure.holes.windows import Place

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
_FIRST_STEPS = 3
_Met = tuple[NDArray[np.intp], NDArray[np.float64]]
"""Flat indices (H,) of the first measured cells from places, -1 for none, and the steps to them, inf for none."""


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


def lowest_through(lines: list[Line], rim_mm: NDArray[np.float64], place: Place, cell_mm: float) -> Lowest:
    """Of twelve lines through hole cells, all around, the one whose higher rim is lowest.

    Along a slot between walls it runs from its one end to its other, where the floor may be seen; ``lines`` are those
    of `lines_through`.
    """
    ways = np.deg2rad(np.array(_TURNS_DEG))[:, None] + np.array([np.pi, 0.0])  # both sides
    down, across = (np.repeat(part.ravel(), len(place[0])) for part in (np.sin(ways), np.cos(ways)))
    start = (np.tile(place[0], ways.size), np.tile(place[1], ways.size))
    at, steps = (
        part.reshape(*ways.shape, -1)
        for part in _march(np.isfinite(rim_mm), start, (down, across), _LONGEST_CELLS)
    )
    height = np.where(at >= 0, rim_mm.ravel()[at], np.nan)
    fixed = [np.stack([line.near_mm, line.far_mm, line.near_at_mm, line.far_at_mm]) for line in lines[1:]]
    turned = np.concatenate([height, steps * cell_mm], axis=1)
    near, far, near_at, far_at = np.concatenate([fixed, turned]).transpose(1, 0, 2)
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
    place: Place,
    gradient: NDArray[np.float64],
    lean: NDArray[np.float64],
    cell_mm: float,
) -> list[Line]:
    """Five lines through the hole cells ``place`` of a field ``rim_mm`` (Ny, Nx) with NaN in its holes.

    The camera's own line comes first (along ``lean`` (2, Ny, Nx)), then four fixed ones.
    """
    tan_x, tan_y = lean[0][place], lean[1][place]
    tangent = np.hypot(tan_x, tan_y)
    straight_down = tangent < 1e-9
    unit = np.where(straight_down, 1.0, tangent)
    down, across = np.where(straight_down, 0.0, tan_y / unit), np.where(straight_down, 1.0, tan_x / unit)

    def line(
        near: _Met,
        far: _Met,
        step_mm: float,
        way: tuple[NDArray[np.float64] | float, ...],
        slant: NDArray[np.float64],
    ) -> Line:
        height = [np.where(at >= 0, rim_mm.ravel()[at], np.nan) for at, _ in (near, far)]
        x, y = ([np.where(at >= 0, part.ravel()[at], 0.0) for at, _ in (near, far)] for part in gradient)
        steep = [np.hypot(*pair) for pair in zip(x, y, strict=True)]
        rise = [pair[0] * way[1] + pair[1] * way[0] for pair in zip(x, y, strict=True)]
        return Line(*height, near[1] * step_mm, far[1] * step_mm, *steep, *rise, slant, straight_down)

    measured = np.isfinite(rim_mm)
    ends = [_march(measured, place, (sign * down, sign * across)) for sign in (-1, 1)]
    found = [line(ends[0], ends[1], cell_mm, (down, across), tangent)]
    for way in _DIRECTIONS:
        length = float(np.hypot(*way))
        slant = (tan_x * way[1] + tan_y * way[0]) / length
        ends = [_swept(measured, toward, place) for toward in (way, (-way[0], -way[1]))]
        found.append(line(ends[0], ends[1], cell_mm * length, (way[0] / length, way[1] / length), slant))
    return found


def _swept(measured: NDArray[np.bool_], way: tuple[int, int], place: Place) -> _Met:
    """The first measured cell from each place against ``way``, one of `_DIRECTIONS` or against it."""
    rows, columns = measured.shape
    down, across = way
    if way not in _DIRECTIONS:
        turned = (rows - 1 - place[0], columns - 1 - place[1])
        at, steps = _swept(measured[::-1, ::-1], (-down, -across), turned)
        return np.where(at >= 0, measured.size - 1 - at, -1), steps
    count = np.arange(rows)[:, None]
    if down:
        # each row moved on so far that the way leads straight down
        column = np.arange(columns) + (across < 0) * count + (across > 0) * (rows - 1 - count)
        moved = np.full((rows, columns + abs(across) * (rows - 1)), -1)
        moved[count, column] = np.where(measured, count, -1)
        steps = place[0] - (last := np.maximum.accumulate(moved, axis=0)[place[0], column[place]])
    else:
        along = np.where(measured, np.arange(columns), -1)
        steps = place[1] - (last := np.maximum.accumulate(along, axis=1)[place])
    at = (place[0] - down * steps) * columns + place[1] - across * steps
    return np.where(last >= 0, at, -1), np.where(last >= 0, steps, np.inf)


def _march(
    measured: NDArray[np.bool_],
    start: Place,
    way: tuple[NDArray[np.float64], NDArray[np.float64]],
    longest: int | None = None,
) -> _Met:
    """The first measured cell from each start along its own way."""
    found = np.full(len(start[0]), -1)
    steps = np.full(len(found), np.inf)
    going = np.arange(len(found))
    rows, columns = measured.shape
    first, end = 1, longest or max(measured.shape)
    while len(going) and first < end:
        # ever more steps at once for the ever fewer lines that go on
        ahead = np.arange(first, min(2 * first + _FIRST_STEPS, end))
        row, column = (
            np.rint(at[going, None] + part[going, None] * ahead).astype(np.intp)
            for at, part in zip(start, way, strict=True)
        )
        inside = (row >= 0) & (column >= 0) & (row < rows) & (column < columns)
        flat = np.where(inside, row * columns + column, 0)
        over = ~inside | measured.ravel()[flat]
        pick = (np.arange(len(going)), np.argmax(over, axis=1))
        met = over[pick] & inside[pick]
        found[going[met]], steps[going[met]] = flat[pick][met], ahead[pick[1]][met]
        going, first = going[~over[pick]], int(ahead[-1]) + 1
    return found, steps
