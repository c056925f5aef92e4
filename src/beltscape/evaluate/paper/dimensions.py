"""Tables 2 and 3: the module's dimensions by the paper, its method, Beltscape and the baseline sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from beltscape.evaluate.paper.numbers import Dimension

MeasuredDimensions = Mapping[str, tuple[float, float]]
""""name quantity" → measured value and its σ, mm; without those that were not measured."""


@dataclass(frozen=True, slots=True, eq=False)
class DimensionRow:
    """One dimension as measured by each method."""

    dimension: Dimension
    measured_mm: Mapping[str, float]
    """Measured dimension by method; NaN: not measured."""
    sigma_mm: Mapping[str, float]
    """Predicted σ by method; NaN: none."""

    def error_mm(self, by: str) -> float:
        """Return measured minus actual value."""
        return self.measured_mm[by] - self.dimension.actual_mm


def tabulate_dimensions(
    dimensions: Sequence[Dimension], measured: Mapping[str, MeasuredDimensions]
) -> tuple[DimensionRow, ...]:
    """Return every dimension by every method; a mean of several quantities requires all of them."""
    rows: list[DimensionRow] = []
    for dimension in dimensions:
        values = {by: _mean(dimension, quantities) for by, quantities in measured.items()}
        rows.append(
            DimensionRow(
                dimension,
                {by: value for by, (value, _) in values.items()},
                {by: sigma for by, (_, sigma) in values.items()},
            )
        )
    return tuple(rows)


def largest_error_mm(rows: Sequence[DimensionRow], by: str) -> float:
    """Return the largest error of the measured dimensions; NaN without any."""
    errors = np.abs([row.error_mm(by) for row in rows])
    return float(np.nanmax(errors)) if np.isfinite(errors).any() else np.nan


def _mean(dimension: Dimension, quantities: MeasuredDimensions) -> tuple[float, float]:
    if any(name not in quantities for name in dimension.of):
        return np.nan, np.nan
    values, sigmas = np.transpose([quantities[name] for name in dimension.of])
    # neighbouring steps share a cube, so their errors do not average out; the RMS σ of one step is used
    return float(values.mean()), float(np.sqrt((sigmas**2).mean()))
