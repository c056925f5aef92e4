"""The rims of holes: from every hole cell along lines to the first measured cells on both sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import load
from beltscape.kernels.arrays import CellIndices
from beltscape.kernels.ray_march import FirstHits

_LOADED_MM = 5.0
"""What lies no higher is bare belt."""
_DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Rows, columns: along x, along y, both diagonals."""
_TURNS_DEG = (14, 31, 59, 76, 104, 121, 149, 166)
"""And between these, 14° to 17° apart; none of them steps on the border between two cells."""
_LONGEST_CELLS = 95
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
    loaded = np.where(value_mm > _LOADED_MM, value_mm, np.nan)
    half = 1
    while 2 * half < max(value_mm.shape):
        off = []
        down = np.s_[half:-half, 2 * half :, : -2 * half]
        for here, after, before in (down, [(slice(None), part) for part in down]):
            bend = np.abs(loaded[here] - 0.5 * (value_mm[after] + value_mm[before]))
            off.append(bend[np.isfinite(bend)])
        if len(values := np.concatenate(off)) < 200:
            break
        apart.append(2 * half * cell_mm)
        rms.append(max(rms[-1], 1.4826 * float(np.median(values, overwrite_input=True))))
        half *= 2
    return Hollows(np.array(apart), np.array(rms))


def gradients(value_mm: NDArray[np.float64], cell_mm: float) -> NDArray[np.float64]:
    """(2, Ny, Nx) slope in x and y of the plane fitted to the cells about each; 0 where too few were measured."""
    return load().plane_slopes(value_mm) / cell_mm


def lowest_through(
    lines: list[Line], rim_mm: NDArray[np.float64], place: CellIndices, cell_mm: float
) -> Lowest:
    """Of twelve lines through hole cells, all around, the one whose higher rim is lowest.

    Along a slot between walls it runs from its one end to its other, where the floor may be seen; ``lines`` are those
    of `lines_through`.
    """
    ways = np.deg2rad(np.array(_TURNS_DEG))[:, None] + np.array([np.pi, 0.0])  # both sides
    down, across = np.sin(ways).reshape(-1, 1), np.cos(ways).reshape(-1, 1)
    met = load().first_hits(np.isfinite(rim_mm), place, down, across, _LONGEST_CELLS)
    at, steps = (part.reshape(*ways.shape, -1) for part in met)
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
    first = np.ones(upper.shape, bool)
    for key in (upper, cells, lower, np.round(nearer, 9)):
        rest = np.where(first, key, np.inf)
        first &= rest == np.fmin.reduce(rest)
    own = np.argmax(first, axis=0)[None]
    picked = (np.take_along_axis(part, own, axis=0)[0] for part in (upper, lower, gap, nearer))
    return Lowest(*picked)


def lines_through(
    rim_mm: NDArray[np.float64],
    place: CellIndices,
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
        ends: FirstHits,
        step_mm: float,
        way: tuple[NDArray[np.float64] | float, ...],
        slant: NDArray[np.float64],
    ) -> Line:
        met = ends.cell >= 0
        height = np.where(met, rim_mm.ravel()[ends.cell], np.nan)
        x, y = (np.where(met, part.ravel()[ends.cell], 0.0) for part in gradient)
        rise = x * way[1] + y * way[0]
        return Line(*height, *(ends.steps * step_mm), *np.hypot(x, y), *rise, slant, straight_down)

    measured, both = np.isfinite(rim_mm), np.array([-1.0, 1.0])[:, None]
    farthest = max(measured.shape) - 1
    own = load().first_hits(measured, place, both * down, both * across, farthest)
    found = [line(own, cell_mm, (down, across), tangent)]
    ways = (both[:, 0] * np.array(_DIRECTIONS)[..., None]).transpose(1, 0, 2).reshape(2, -1, 1)
    met = load().first_hits(measured, place, *ways, farthest)
    for k, way in enumerate(_DIRECTIONS):
        length = float(np.hypot(*way))
        slant = (tan_x * way[1] + tan_y * way[0]) / length
        ends = FirstHits(*(part[2 * k : 2 * k + 2] for part in met))
        found.append(line(ends, cell_mm * length, (way[0] / length, way[1] / length), slant))
    return found
