"""Heights over the learned empty belt, reduced to robust values of small cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.statistics import MAD_TO_SIGMA, MEDIAN_TO_MEAN_SIGMA
from beltscape.measure.belt.reference import LEAST_CONFIDENCE, EmptyBeltReference

_CELLS_ACROSS = 32
"""Cells over the belt's width: a bare strip of a tenth of the width holds three of them."""
_SAMPLE_COUNT = 25_000
"""Approximate number of pixels to which the depth map is thinned; it bounds the time."""
_LEAST_FILL = 0.3
"""A cell with a smaller share of the usual number of pixels counts as not measured."""


@dataclass(frozen=True, slots=True, eq=False)
class BeltCells:
    """The cells of the belt that one frame measured, in the learned belt's frame."""

    x_mm: NDArray[np.float64]
    """(N,) mean position across of the cell's points."""
    y_mm: NDArray[np.float64]
    """(N,) mean position along."""
    height_mm: NDArray[np.float64]
    """(N,) median height over the learned empty belt."""
    scatter_mm: NDArray[np.float64]
    """(N,) robust scatter of the points about the cell's median or plane, the smaller of both."""
    sigma_mm: NDArray[np.float64]
    """(N,) one standard deviation of the height on a bare belt, for errors independent between cells."""
    column: NDArray[np.intp]
    """(N,) number of the cell across."""
    row: NDArray[np.intp]
    """(N,) number of the cell along."""
    shape: tuple[int, int]
    """Numbers of rows and columns of all cells in view, measured or not."""
    side_mm: float
    """Edge of a cell."""
    y_middle_mm: float
    """Middle of the view along the belt."""

    y_extent_mm: float
    """Length of all rows of cells."""
    other_size_mm: float = 0.0
    """σ of the mean height where the belt was learned from images of another size."""

    def __len__(self) -> int:
        return len(self.x_mm)


def compute_belt_cells(depth: DepthMap, reference: EmptyBeltReference) -> BeltCells:
    """Return the cells within the learned edges and the view that a depth map measured."""
    belt, camera = reference.belt, reference.camera
    low, high = belt.across_mm
    side = (high - low) / _CELLS_ACROSS
    y_low, y_high = reference.seen_mm
    shape = (max(1, int((y_high - y_low) / side)), _CELLS_ACROSS)
    stride = max(1, round(np.sqrt(depth.depth_mm.size / _SAMPLE_COUNT)))
    thin = slice(stride // 2, None, stride)
    z = depth.depth_mm[thin, thin].astype(np.float64)
    good = np.isfinite(z) & (depth.confidence[thin, thin] >= LEAST_CONFIDENCE)
    points = np.concatenate([camera.rays(thin)[good], np.ones((int(good.sum()), 1))], axis=-1)
    x, y, z = belt.belt_from_core.apply(points * z[good][:, None]).T
    bottom = belt.height_at_mm(x, y)
    column, row = (np.floor((part - start) / side).astype(np.intp) for part, start in ((x, low), (y, y_low)))
    inside = (column >= 0) & (column < shape[1]) & (row >= 0) & (row < shape[0])
    cell = (row * shape[1] + column)[inside]
    return _reduce(cell, x[inside], y[inside], (z - bottom)[inside], reference, shape, side, stride)


def _reduce(
    cell: NDArray[np.intp],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    height: NDArray[np.float64],
    reference: EmptyBeltReference,
    shape: tuple[int, int],
    side: float,
    stride: int,
) -> BeltCells:
    """Return medians and scatter of the points' heights by cell."""
    count = np.bincount(cell, minlength=shape[0] * shape[1])
    usual = (side / (stride * reference.cell_mm)) ** 2
    full = np.flatnonzero(count >= max(5.0, _LEAST_FILL * usual))
    median = _median_by_cell(cell, height, count)
    # a grain spoils the plane, an inclination the median
    spread = (
        _median_by_cell(cell, np.abs(off), count)
        for off in (height - median[cell], _subtract_planes(cell, x, y, height, count))
    )
    scatter = MAD_TO_SIGMA * np.fmin(*spread)
    belt = reference.belt
    mean_x, mean_y = (np.bincount(cell, part, len(count))[full] / count[full] for part in (x, y))
    patches = np.maximum(count[full] * stride**2 / max(belt.correlation_px**2, 1.0), 1.0)
    learned = np.interp(mean_x, belt.x_mm, belt.z_sigma_mm)
    if belt.deviation is not None:
        learned = np.hypot(learned, np.median(belt.deviation.sigma_mm))
    noise = np.maximum(belt.noise_mm, scatter[full])
    return BeltCells(
        x_mm=mean_x,
        y_mm=mean_y,
        height_mm=median[full],
        scatter_mm=scatter[full],
        sigma_mm=np.hypot(MEDIAN_TO_MEAN_SIGMA * noise / np.sqrt(patches), learned),
        column=full % shape[1],
        row=full // shape[1],
        shape=shape,
        side_mm=side,
        y_middle_mm=reference.seen_mm[0] + 0.5 * shape[0] * side,
        y_extent_mm=shape[0] * side,
        other_size_mm=reference.other_size_mm,
    )


def _subtract_planes(
    cell: NDArray[np.intp],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    height: NDArray[np.float64],
    count: NDArray[np.intp],
) -> NDArray[np.float64]:
    """Return the heights of the points over the plane fitted to their cell by least squares."""

    def total(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.bincount(cell, values, len(count)).astype(np.float64)

    number = np.maximum(count, 1)
    x, y, height = (part - (total(part) / number)[cell] for part in (x, y, height))
    xx, xy, yy, xh, yh = total(x * x), total(x * y), total(y * y), total(x * height), total(y * height)
    determinant = np.maximum(xx * yy - xy**2, 1e-9)
    across, along = (xh * yy - yh * xy) / determinant, (yh * xx - xh * xy) / determinant
    return height - across[cell] * x - along[cell] * y


def _median_by_cell(
    cell: NDArray[np.intp], values: NDArray[np.float64], count: NDArray[np.intp]
) -> NDArray[np.float64]:
    """Return the (lower) median of the values of each cell; NaN for a cell without any."""
    order = np.argsort(values)
    small = cell[order].astype(np.uint16 if len(count) < 2**16 else np.uint32)  # 16 bits are sorted by radix
    ranked = values[order[np.argsort(small, kind="stable")]]
    middle = np.cumsum(count) - count + np.maximum(count - 1, 0) // 2
    out = np.full(len(count), np.nan)
    filled = count > 0
    out[filled] = ranked[middle[filled]]
    return out
