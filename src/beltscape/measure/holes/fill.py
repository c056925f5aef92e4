"""Filling of occlusion holes: heights with σ for cells that were not measured."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.kernels.arrays import CellIndices
from beltscape.learned.network import Network
from beltscape.learned.registry import load_network
from beltscape.measure.holes.features import compute_features, measure_neighbourhood
from beltscape.measure.holes.rims import (
    WINDOWS,
    RimProfiles,
    SmoothSurface,
    StructureFunction,
    compute_rim_profiles,
    estimate_structure_function,
    find_lowest_line,
    fit_gradients,
    fit_quadrics,
    predict_smooth_surface,
    trace_lines,
)

_CELLS_AT_ONCE = 1 << 18
"""Cells whose inputs are held at a time: a cell takes 2 kB, and a view of 1.2 million cells has some 200 000 in
holes."""
_RATIOS = (-5.0, 5.0)
"""Limits of a height's distance from the smooth surface, in units of its scale."""


@dataclass(frozen=True, slots=True, eq=False)
class Filled:
    """A field without holes."""

    value_mm: NDArray[np.float64]
    """(Ny, Nx) measured values, and predicted ones in the holes."""
    sigma_mm: NDArray[np.float64]
    """(Ny, Nx) one standard deviation; in the holes that of the prediction."""
    hole: NDArray[np.bool_]
    """(Ny, Nx) whether a cell was not measured."""


@dataclass(frozen=True, slots=True, eq=False)
class HoleInputs:
    """The inputs from which the heights of H hole cells are predicted, row by row."""

    profiles: RimProfiles
    """The rims along five lines."""
    surface: SmoothSurface
    """The smooth surface, and the range of deviation from it."""
    features: dict[str, NDArray[np.float64]]
    """(H,) features of the network by name."""


def fill_holes(
    value_mm: NDArray[np.float64],
    sigma_mm: NDArray[np.float64],
    pinhole: NDArray[np.bool_],
    cell_mm: float,
    ray_slope: NDArray[np.float64] | None = None,
    *,
    rows: slice = slice(None),
    network: Network | None = None,
) -> Filled:
    """Fill the NaN cells of a field (Ny, Nx) of heights over the belt.

    For each hole cell the rims of its hole are found along five lines: across, along, both diagonals, and the core's
    line of sight (``ray_slope`` (2, Ny, Nx) are the rays' slopes in x and y; None for vertical rays). A quadratic
    through the measured cells around it predicts a smooth surface, which holds where these cells follow it.
    Otherwise the height is open within a range that grows with the height difference of the rims and the roughness
    of the measured surface. A small network predicts from dimensionless features the mean and σ of the height in
    this range. It (``network``; None for Beltscape's own) was fitted by the mean square to simulated heaps and
    modules with known truth (tools/training), so that sums over many cells, such as a volume, are unbiased.

    No cell is put below both its lowest rim and the belt, or above both its highest rim and the smooth surface.
    Outside the outermost measured cells the nearest value is used. ``pinhole`` (Ny, Nx) marks gaps between the points
    of neighbouring pixels. Holes outside ``rows`` are not filled.

    Raises
    ------
    ValueError
        if nothing was measured.
    """
    hole = ~np.isfinite(value_mm)
    if hole.all():
        raise ValueError("nothing to interpolate from")
    requested = np.zeros_like(hole)
    requested[rows] = hole[rows]
    if not requested.any():
        return Filled(value_mm, sigma_mm, hole)
    ray_slope = np.zeros((2, *hole.shape)) if ray_slope is None else ray_slope
    value, sigma = value_mm.copy(), sigma_mm.copy()
    network, usual = network or load_network("holes"), float(np.median(sigma_mm[np.isfinite(sigma_mm)]))
    field = _HoleField.of(value_mm, pinhole, cell_mm, ray_slope)
    rows_of_holes, columns = np.nonzero(requested)
    for start in range(0, len(columns), _CELLS_AT_ONCE):
        cells = rows_of_holes[start : start + _CELLS_AT_ONCE], columns[start : start + _CELLS_AT_ONCE]
        value[cells], spread = _predict_heights(field.compute_inputs(cells), network)
        sigma[cells] = np.hypot(spread, usual)
    unfilled = requested & ~np.isfinite(value)
    if unfilled.any():
        _extrapolate(value, sigma, unfilled)
    return Filled(value, sigma, hole)


def compute_hole_inputs(
    value_mm: NDArray[np.float64],
    pinhole: NDArray[np.bool_],
    cell_mm: float,
    ray_slope: NDArray[np.float64],
    cells: CellIndices,
) -> HoleInputs:
    """Return the inputs of the prediction for the hole ``cells`` of a field (Ny, Nx)."""
    return _HoleField.of(value_mm, pinhole, cell_mm, ray_slope).compute_inputs(cells)


@dataclass(frozen=True, slots=True, eq=False)
class _HoleField:
    """A field (Ny, Nx) with holes, and what all predictions in it share."""

    value_mm: NDArray[np.float64]
    pinhole: NDArray[np.bool_]
    cell_mm: float
    ray_slope: NDArray[np.float64]
    filtered: NDArray[np.float64]
    """The heights with their rims smoothed."""
    gradients: NDArray[np.float64]
    """(2, Ny, Nx) slopes in x and y."""
    roughness: StructureFunction

    @classmethod
    def of(
        cls,
        value_mm: NDArray[np.float64],
        pinhole: NDArray[np.bool_],
        cell_mm: float,
        ray_slope: NDArray[np.float64],
    ) -> _HoleField:
        filtered = _filter_rims(value_mm, ~np.isfinite(value_mm))
        gradients, roughness = (
            fit_gradients(value_mm, cell_mm),
            estimate_structure_function(value_mm, cell_mm),
        )
        return cls(value_mm, pinhole, cell_mm, ray_slope, filtered, gradients, roughness)

    def compute_inputs(self, cells: CellIndices) -> HoleInputs:
        """Return the inputs of the prediction for hole ``cells``; each depends on its own cell only."""
        lines = trace_lines(self.filtered, cells, self.gradients, self.ray_slope, self.cell_mm)
        profiles, lowest = (
            compute_rim_profiles(lines),
            find_lowest_line(lines, self.filtered, cells, self.cell_mm),
        )
        quadric_fits = fit_quadrics(self.value_mm, cells, WINDOWS)
        surface = predict_smooth_surface(profiles, quadric_fits, self.roughness, self.cell_mm)
        neighbourhood = measure_neighbourhood(self.value_mm, self.filtered, cells, self.cell_mm)
        tangent = np.hypot(self.ray_slope[0][cells], self.ray_slope[1][cells])
        pinhole = self.pinhole[cells]
        return HoleInputs(
            profiles,
            surface,
            compute_features(
                profiles, lowest, surface, quadric_fits, neighbourhood, pinhole, tangent, self.cell_mm
            ),
        )


def _predict_heights(inputs: HoleInputs, network: Network) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Predict mean and σ (H,) of the heights by the network; NaN where no line has two rims."""
    offset, sigma = network.predict_mean_and_sigma(inputs.features)
    base, scale, floor = inputs.surface.base_mm, inputs.surface.scale_mm, inputs.profiles.floor_mm
    mean = base + scale * np.clip(offset, *_RATIOS)
    # no height lies below both the lowest rim and the belt
    return np.clip(mean, np.fmin(floor, 0.0), np.fmax(inputs.profiles.ceiling_mm, base)), scale * sigma


def _filter_rims(value: NDArray[np.float64], hole: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the field with rim cells replaced by the median of their measured neighbours, against flying pixels."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    rows, columns = np.nonzero((cv2.dilate(hole.view(np.uint8), cross) > 0) & ~hole)
    padded = np.pad(value, 1, constant_values=np.nan)
    neighbours = np.stack([padded[rows + i, columns + j] for i in range(3) for j in range(3)])
    neighbours.sort(axis=0)  # NaN goes last
    number = np.isfinite(neighbours).sum(axis=0)
    filtered = value.copy()
    pick = np.arange(len(rows))
    filtered[rows, columns] = 0.5 * (neighbours[(number - 1) // 2, pick] + neighbours[number // 2, pick])
    return filtered


def _extrapolate(value: NDArray[np.float64], sigma: NDArray[np.float64], unfilled: NDArray[np.bool_]) -> None:
    """Fill cells without two rims by the nearest known cell's value, with the field's standard deviation as σ."""
    known = np.isfinite(value)
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    assert isinstance(nearest, np.ndarray)
    near = tuple(part[unfilled] for part in nearest)
    sigma[unfilled] = np.hypot(sigma[near], float(np.std(value[known])))
    value[unfilled] = value[near]
