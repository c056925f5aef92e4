"""Tables 2 and 3: the module's dimensions, by the paper, by its method here, by ours, and by other sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from beltscape.evaluate.paper.numbers import Dimension

MeasuredDimensions = Mapping[str, tuple[float, float]]
""""name quantity" → measured value and its σ, mm; what was not found is absent."""


@dataclass(frozen=True, slots=True, eq=False)
class DimensionRow:
    """One dimension by everyone who measured it."""

    dimension: Dimension
    measured_mm: Mapping[str, float]
    """By whom; NaN: not measured."""
    sigma_mm: Mapping[str, float]
    """As predicted; NaN where there is none."""

    def error_mm(self, by: str) -> float:
        """Measured minus actual."""
        return self.measured_mm[by] - self.dimension.actual_mm


def tabulate_dimensions(
    dimensions: Sequence[Dimension], measured: Mapping[str, MeasuredDimensions]
) -> tuple[DimensionRow, ...]:
    """Every dimension by everyone of ``measured``; where it is the mean of several, all of them must be there."""
    rows = []
    for dimension in dimensions:
        values = {by: _mean(dimension, found) for by, found in measured.items()}
        rows.append(
            DimensionRow(
                dimension,
                {by: value for by, (value, _) in values.items()},
                {by: sigma for by, (_, sigma) in values.items()},
            )
        )
    return tuple(rows)


def largest_error_mm(rows: Sequence[DimensionRow], by: str) -> float:
    """Of all dimensions that were measured; NaN where none was."""
    errors = np.abs([row.error_mm(by) for row in rows])
    return float(np.nanmax(errors)) if np.isfinite(errors).any() else np.nan


def _mean(dimension: Dimension, found: MeasuredDimensions) -> tuple[float, float]:
    if any(name not in found for name in dimension.of):
        return np.nan, np.nan
    values, sigmas = np.transpose([found[name] for name in dimension.of])
    # neighbouring steps share a cube, so their errors do not average out: the σ of one of them is kept
    return float(values.mean()), float(np.sqrt((sigmas**2).mean()))
