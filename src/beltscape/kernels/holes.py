"""Kernels of occlusion holes: heights with σ for cells of a field that were not measured.

For each hole cell the rims of its hole are found along lines, a smooth surface is predicted from the measured cells
around, and a small network predicts the height from dimensionless features (`HOLE_FEATURES`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.arrays import float32
from beltscape.kernels.backend import KernelFamily
from beltscape.kernels.networks import network_layers

TERMS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
"""Powers of x and y in a quadratic."""
FEWEST = 12
"""Least number of cells of a quadratic: twice its six coefficients."""
MOST_LEVERAGE = 30.0
"""Limit of the leverage; a value with more is extrapolated too far. The networks of the holes were fitted with this
value."""
RIDGE = 1e-6
"""Ridge as a share of the cells, above the rounding errors: cells on one line determine no quadratic."""
LEAST_SHARE = 1e-3
"""A window with a smaller share of measured cells has no mean: ten cells of the largest window of 101 × 101."""
SLOPE_SIDE = 7
"""Side of the window in which a plane is fitted, cells. The networks of the holes were fitted with this value."""
LEAST_SPREAD = 1e-3
"""Least 1 - correlation² of the cells' positions; cells closer to a line than this determine no plane."""
LOADED_MM = 5.0
"""Cells no higher than this are bare belt."""
LEAST_BENDS = 200
"""Number of bends from which on their median is taken. Chosen."""
DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Directions (rows, columns) along x, along y and both diagonals."""
TURNS_DEG = (14, 31, 59, 76, 104, 121, 149, 166)
"""Directions between these, 14° to 17° apart; none of them runs along a border between cells."""
LONGEST_CELLS = 95
"""Lines along slots end at this distance on either side."""
WINDOWS = (9, 25, 51, 101)
"""Cells across the windows in which quadratics are fitted."""
REACH_CELLS = 5
"""A window extends this far beyond the shortest gap."""
OPEN = 4.0
"""Heights in a hole may deviate from the smooth surface by this multiple of the deviation of measured cells."""
SMOOTH = 0.03
"""A surface is smooth, gradually, where it deviates from a quadratic by less than this share of half the window."""
TINY_MM = 1e-6
"""Added so that an exactly flat surface does not divide by zero."""
OPEN_CELLS = (5, 11, 25, 51)
"""Cells across the windows in which the share of hole cells is computed."""
LOW_CELLS = (11, 25, 51)
"""Cells across the windows in which the lowest measured cell is found."""
ROUGH_CELLS = (25, 71)
"""Cells across the windows in which roughness is averaged."""
BEND_CELLS = 2
"""Roughness is a cell's deviation from the mean of the two cells at this distance on both sides."""
MOST_RATIO = 4.0
"""Ratios are clipped to this."""
NO_LEVERAGE = 99.0
"""Leverage where no quadric was fitted, and its largest value."""
BARE_CELLS = 3.0
"""Unit of heights over the belt: a few of these separate the bare belt from a load."""
RATIOS = (-5.0, 5.0)
"""Limits of a height's distance from the smooth surface, in units of its scale."""
LOG_VARIANCE = (-12.0, 3.0)
"""Limits to which a predicted logarithm of a variance is clipped: σ from 0.0025 to 4.5 of its unit."""

CONTINUED_CELLS = 8
"""Lines of the continuation end at this distance; nine tenths of the missed cells that a frame saw lit lie within 3.6
cells of measured ones."""
PLANE_CELLS = 2
"""Half the window in which a plane is fitted at the end of a line, cells."""
STEEPEST = 3.0
"""Cells of a window that rise more than this, over their distance, from its centre belong to another surface."""
SUPPORT_CELLS = 1.2
"""Predictions that differ by less than this, in edges of a cell, support each other."""
MOST_CELLS = 32.0
"""Differences of heights are limited to this, in edges of a cell."""
LOGIT = (-1.66, -0.204, 0.84, -0.0425, 0.0403)
"""Weights of the logit of the probability that a prediction is right to `SUPPORT_CELLS`: constant, distance in cells,
sum of the inverse distances of the predictions that support it, height above the lowest and below the highest
prediction in cells. Fitted by maximum likelihood to 90,000 hole cells of three simulated heaps with three to five
cameras; fits to each heap alone differ by up to a fifth, in the constant by 0.4."""
CONTINUED_ALONG = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))
"""Rows and columns of a step along each line of the continuation."""

LINES = ("line of sight", "shortest line", "second line", "third line", "longest line")
"""Names of the lines: the core's line of sight, then four others by ascending gap."""
_OF_A_LINE = (
    "one rim", "upper rim", "lower rim", "drop", "place", "upper slope", "lower slope", "shadow", "ray slope",
    "relative gap", "distance to the nearer rim", "upper tangent", "lower tangent", "upper rise", "lower rise",
    "log gap",
)  # fmt: skip
_OF_A_CELL = (
    "floor", "ceiling", "range angle", "base over scale", "floor over scale", "base over gap", "floor over gap",
    "structure of the gap", "structure of four gaps", "structure over scale", "log gap", "ray slope", "pinhole",
    "floor over belt", "ceiling over belt", "scale over gap", "smooth", "straight line",
)  # fmt: skip
_OF_A_WINDOW = (
    "mean within {}", "quadric within {}", "quadric rms within {}", "quadric rms angle within {}",
    "log leverage within {}",
)  # fmt: skip
_OF_THE_LOWEST_LINE = (
    "upper rim", "lower rim", "relative gap", "log gap", "distance to the nearer rim", "below the shortest",
)  # fmt: skip
_OF_THE_LOWEST_CELL = (
    "lowest within {}",
    "lowest within {} below the floor",
    "lowest within {} below the shortest line",
)
HOLE_FEATURES = (
    *(f"{line}: {name}" for line in LINES for name in _OF_A_LINE),
    *_OF_A_CELL,
    *(f"hole share within {side}" for side in OPEN_CELLS),
    "log depth",
    *(name.format(side) for side in WINDOWS for name in _OF_A_WINDOW),
    *(f"roughness within {side}" for side in ROUGH_CELLS),
    *(f"lowest line: {name}" for name in _OF_THE_LOWEST_LINE),
    *(name.format(side) for side in LOW_CELLS for name in _OF_THE_LOWEST_CELL),
)
"""Names of the features of a hole cell, in the order in which kernels give them."""
_NUMBERS = {name: number for number, name in enumerate(HOLE_FEATURES)}


class HoleField(NamedTuple):
    """Checked input of `hole_inputs`: a field of heights over the belt, and the rows whose holes count."""

    field: NDArray[np.float64]
    """(Ny, Nx) heights, NaN where not measured."""
    pinhole: NDArray[np.bool_]
    """(Ny, Nx)"""
    ray_slope: NDArray[np.float64]
    """(2, Ny, Nx)"""
    cell: float
    first: int
    end: int


class HolesInput(NamedTuple):
    """Checked input of `fill_holes`."""

    holes: HoleField
    sigma: NDArray[np.float64]
    """(Ny, Nx)"""
    order: NDArray[np.int32]
    """(n,) the network's inputs as indices of `HOLE_FEATURES`."""
    limits: NDArray[np.float32]
    """(2, n)"""
    layers: list[NDArray[np.float32]]


class HoleInputs(NamedTuple):
    """Inputs of the prediction of the heights of H hole cells, row by row."""

    features: NDArray[np.floating]
    """(F, H) `HOLE_FEATURES`: ratios of heights and lengths, angles, logarithms."""
    base: NDArray[np.float64]
    """(H,) height of the smooth surface; NaN where no line has a rim on both sides."""
    scale: NDArray[np.float64]
    """(H,) range in which the height may deviate from it."""


class ContinuationInput(NamedTuple):
    """Checked input of `continue_surface`: a field of heights over the belt, and the rows whose holes count."""

    field: NDArray[np.float64]
    """(Ny, Nx) heights, NaN where not measured."""
    cell: float
    first: int
    end: int


class ContinuedSurface(NamedTuple):
    """The most probable continuation of a surface at H hole cells, row by row."""

    height: NDArray[np.float64]
    """(H,) NaN where no measured cell is in reach."""
    probability: NDArray[np.float64]
    """(H,) that the height is right to about a cell's edge; 0 where it is NaN."""


class FilledField(NamedTuple):
    """A field without holes in the rows asked for."""

    value: NDArray[np.float64]
    """(Ny, Nx) measured heights, and predicted ones in the holes."""
    sigma: NDArray[np.float64]
    """(Ny, Nx) one standard deviation; in the holes that of the prediction."""


class HoleFillingKernels(KernelFamily):
    """Kernels of the hole cells in rows of a ``field`` (Ny, Nx) of heights over the belt; NaN: not measured.

    A cell's height is that of the smooth surface, plus ``scale`` times the network's first output, limited to
    `RATIOS`; its second output is the logarithm of the variance, in units of ``scale``², limited to `LOG_VARIANCE`.
    No height lies below both the lowest rim and the belt, or above both the highest rim and the smooth surface. Cells
    without any line with two rims take the value of the nearest known cell, of several that of the first column, then
    row, and the standard deviation of the known cells.
    """

    def hole_inputs(
        self,
        field: NDArray[np.floating],
        pinhole: NDArray[np.bool_],
        ray_slope: NDArray[np.floating],
        cell: float,
        *,
        rows: slice = slice(None),
        threads: int = 0,
    ) -> HoleInputs:
        """Return the network's features of the hole cells in ``rows``, and its unit.

        Parameters
        ----------
        field
            (Ny, Nx) heights.
        pinhole
            (Ny, Nx) gaps between the points of neighbouring pixels.
        ray_slope
            (2, Ny, Nx) slopes of the core's rays in x and y.
        cell
            Edge of a cell, in the unit of the heights.
        """
        given = _check_field(field, pinhole, ray_slope, cell, rows)
        count = int(np.count_nonzero(~np.isfinite(given.field[given.first : given.end])))
        out = np.empty((len(HOLE_FEATURES), count), np.float32), np.empty(count), np.empty(count)
        return HoleInputs(*self._run("hole_inputs", given, out, threads))

    def fill_holes(
        self,
        planes: tuple[NDArray[np.floating], NDArray[np.floating]],
        pinhole: NDArray[np.bool_],
        ray_slope: NDArray[np.floating],
        cell: float,
        network: tuple[Sequence[str], NDArray[np.floating], Sequence[NDArray[np.floating]]],
        *,
        rows: slice = slice(None),
        threads: int = 0,
    ) -> FilledField:
        """Fill the hole cells in ``rows``; the others stay.

        Parameters
        ----------
        planes
            (Ny, Nx) heights, and their σ.
        pinhole, ray_slope, cell
            See `hole_inputs`.
        network
            The names of its features, limits (2, n) and layers, as in `NetworkKernels.evaluate_network`; of two
            outputs.
        """
        holes = _check_field(planes[0], pinhole, ray_slope, cell, rows)
        names, limits, layers = network
        unknown = [name for name in names if name not in _NUMBERS]
        if unknown:
            raise KernelError(f"the network has a feature {unknown[0]!r} that hole cells do not have")
        weights = network_layers(layers, "features", len(names))
        if len(weights[-1]) != 2:
            raise KernelError(f"the network must have 2 outputs, not {len(weights[-1])}")
        given = HolesInput(
            holes,
            _check_plane("sigma", planes[1], holes.field.shape),
            np.array([_NUMBERS[name] for name in names], np.int32),
            float32("limits", limits, (2, len(names))),
            weights,
        )
        out = np.empty(holes.field.shape), np.empty(holes.field.shape)
        return FilledField(*self._run("fill_holes", given, out, threads))

    def continue_surface(
        self, field: NDArray[np.floating], cell: float, *, rows: slice = slice(None)
    ) -> ContinuedSurface:
        """Return the most probable continuation of the measured surface at the hole cells in ``rows``.

        From a cell a line goes in each of eight directions to the first measured cell, over `CONTINUED_CELLS` cells
        at most. A plane through the cells of its surface around it predicts the cell's height, but none below both
        the belt and the lowest end. Of the predictions the most probable one counts, by the logit of `LOGIT`. Heights
        count in edges of a cell, so that the result does not depend on the scale.
        """
        values = _check_plane("field", field, np.shape(field))
        if values.ndim != 2 or not values.size:
            raise KernelError(f"field must have the shape (Ny, Nx), not {values.shape}")
        first, end = _check_rows(rows, len(values))
        given = ContinuationInput(values, _check_cell(cell), first, end)
        count = int(np.count_nonzero(~np.isfinite(values[first:end])))
        return ContinuedSurface(*self._run("continue_surface", given, (np.empty(count), np.empty(count)), 1))


def _check_field(
    field: NDArray[np.floating],
    pinhole: NDArray[np.bool_],
    ray_slope: NDArray[np.floating],
    cell: float,
    rows: slice,
) -> HoleField:
    """Return the checked field, or raise KernelError."""
    field = np.ascontiguousarray(field, np.float64)
    if field.ndim != 2 or not field.size:
        raise KernelError(f"field must have the shape (Ny, Nx), not {field.shape}")
    if not np.isfinite(field).any():
        raise KernelError("field must have a measured cell")
    pinhole = np.ascontiguousarray(pinhole, bool)
    if pinhole.shape != field.shape:
        raise KernelError(f"pinhole must have the shape {field.shape}, not {pinhole.shape}")
    ray_slope = _check_plane("ray_slope", ray_slope, (2, *field.shape))
    return HoleField(field, pinhole, ray_slope, _check_cell(cell), *_check_rows(rows, len(field)))


def _check_cell(cell: float) -> float:
    if not (np.isfinite(cell) and cell > 0):
        raise KernelError(f"cell must be positive, not {cell:g}")
    return float(cell)


def _check_rows(rows: slice, count: int) -> tuple[int, int]:
    """Return the first row and the end."""
    first, end, step = rows.indices(count)
    if step != 1:
        raise KernelError(f"rows must be next to each other, not every {step}")
    return first, max(first, end)


def _check_plane(name: str, plane: NDArray[np.floating], shape: tuple[int, ...]) -> NDArray[np.float64]:
    plane = np.ascontiguousarray(plane, np.float64)
    if plane.shape != shape:
        raise KernelError(f"{name} must have the shape {shape}, not {plane.shape}")
    return plane
