"""The reference of the kernels of holes: inputs of the prediction, the prediction, and what lies outside all rims."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.kernels.arrays import CellIndices
from beltscape.kernels.holes import (
    HOLE_FEATURES,
    LOG_VARIANCE,
    RATIOS,
    WINDOWS,
    ContinuationInput,
    HoleField,
    HolesInput,
)
from beltscape.kernels.networks import NetworkInput
from beltscape.kernels.reference import hole_continuation
from beltscape.kernels.reference.hole_features import compute_features, measure_neighbourhood
from beltscape.kernels.reference.hole_rims import (
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
from beltscape.kernels.reference.networks import evaluate_network

_CELLS_AT_ONCE = 1 << 18
"""Cells whose inputs are held at a time: a cell takes 2 kB, and a view of 1.2 million cells has some 200 000 in
holes."""
Filled = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True, slots=True, eq=False)
class _Prediction:
    """Inputs of the prediction of the heights of H hole cells."""

    profiles: RimProfiles
    """The rims along five lines."""
    surface: SmoothSurface
    """The smooth surface, and the range of deviation from it."""
    features: dict[str, NDArray[np.float64]]
    """(H,) features of the network by name."""


def hole_inputs(given: HoleField) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return features (F, H), base and scale (H,)."""
    inputs = _SharedField.of(given).compute_inputs(_find_holes(given))
    features = [inputs.features[name] for name in HOLE_FEATURES]
    return np.stack(features), inputs.surface.base_mm, inputs.surface.scale_mm


def continue_surface(given: ContinuationInput) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return heights and probabilities (H,)."""
    return hole_continuation.continue_surface(given)


def fill_holes(given: HolesInput) -> Filled:
    """Return height and σ, (Ny, Nx) each."""
    value, sigma = given.holes.field.copy(), given.sigma.copy()
    rows, columns = _find_holes(given.holes)
    if not len(rows):
        return value, sigma
    shared, usual = _SharedField.of(given.holes), float(np.median(sigma[np.isfinite(sigma)]))
    for start in range(0, len(columns), _CELLS_AT_ONCE):
        cells = rows[start : start + _CELLS_AT_ONCE], columns[start : start + _CELLS_AT_ONCE]
        value[cells], spread = _predict_heights(shared.compute_inputs(cells), given)
        sigma[cells] = np.hypot(spread, usual)
    unfilled = np.zeros(value.shape, bool)
    unfilled[rows, columns] = ~np.isfinite(value[rows, columns])
    if unfilled.any():
        _extrapolate(value, sigma, unfilled)
    return value, sigma


def _find_holes(given: HoleField) -> CellIndices:
    """Return the rows and columns of the hole cells in the rows that count, row by row."""
    rows, columns = np.nonzero(~np.isfinite(given.field[given.first : given.end]))
    return rows + given.first, columns


@dataclass(frozen=True, slots=True, eq=False)
class _SharedField:
    """The parts of all predictions in a field (Ny, Nx) that do not depend on the cell."""

    given: HoleField
    filtered: NDArray[np.float64]
    """The heights with their rims smoothed."""
    gradients: NDArray[np.float64]
    """(2, Ny, Nx) slopes in x and y."""
    roughness: StructureFunction

    @classmethod
    def of(cls, given: HoleField) -> _SharedField:
        filtered = _filter_rims(given.field, ~np.isfinite(given.field))
        gradients = fit_gradients(given.field, given.cell)
        return cls(given, filtered, gradients, estimate_structure_function(given.field, given.cell))

    def compute_inputs(self, cells: CellIndices) -> _Prediction:
        """Return the inputs of the prediction for hole ``cells``; each depends on its own cell only."""
        field, pinhole, ray_slope, cell = self.given[:4]
        lines = trace_lines(self.filtered, cells, self.gradients, ray_slope, cell)
        profiles, lowest = compute_rim_profiles(lines), find_lowest_line(lines, self.filtered, cells, cell)
        quadric_fits = fit_quadrics(field, cells, WINDOWS)
        surface = predict_smooth_surface(profiles, quadric_fits, self.roughness, cell)
        neighbourhood = measure_neighbourhood(field, self.filtered, cells, cell)
        tangent = np.hypot(ray_slope[0][cells], ray_slope[1][cells])
        return _Prediction(
            profiles,
            surface,
            compute_features(
                profiles, lowest, surface, quadric_fits, neighbourhood, pinhole[cells], tangent, cell
            ),
        )


def _predict_heights(inputs: _Prediction, given: HolesInput) -> Filled:
    """Predict mean and σ (H,) of the heights by the network; NaN where no line has two rims."""
    planes = [inputs.features[HOLE_FEATURES[number]].astype(np.float32)[None] for number in given.order]
    outputs = evaluate_network(NetworkInput(planes, given.limits, given.layers))
    offset, log_variance = (output[0] for output in outputs)
    base, scale, floor = inputs.surface.base_mm, inputs.surface.scale_mm, inputs.profiles.floor_mm
    mean = base + scale * np.clip(offset, *RATIOS)
    # no height lies below both the lowest rim and the belt
    mean = np.clip(mean, np.fmin(floor, 0.0), np.fmax(inputs.profiles.ceiling_mm, base))
    return mean, scale * np.exp(0.5 * np.clip(log_variance, *LOG_VARIANCE))


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
    near = tuple(part[unfilled] for part in nearest)  # of equally near ones that of the first column
    sigma[unfilled] = np.hypot(sigma[near], float(np.std(value[known])))
    value[unfilled] = value[near]
