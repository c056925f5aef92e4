"""Bulk density: a value, a table over time, or a product's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Density:
    """Bulk density over time; each entry holds from its time until the next one's, the first also before."""

    time_ns: NDArray[np.int64]
    """(n,) ascending; one entry for a density that does not change."""
    density_kg_m3: NDArray[np.float64]
    """(n,)."""
    sigma_kg_m3: NDArray[np.float64]
    """(n,) one standard deviation."""
    name: str = ""
    """Name of the product, where it has one."""

    @classmethod
    def constant(cls, density_kg_m3: float, sigma_kg_m3: float = 0.0, name: str = "") -> Density:
        """Return a density that does not change."""
        return cls(np.zeros(1, np.int64), np.array([density_kg_m3]), np.array([sigma_kg_m3]), name)

    def at(self, time_ns: int | None) -> tuple[float, float]:
        """Return density and σ at a time, kg/m³; NaN for a table without a time."""
        if len(self.time_ns) == 1:
            return float(self.density_kg_m3[0]), float(self.sigma_kg_m3[0])
        if time_ns is None:
            return float("nan"), float("nan")
        place = max(0, int(np.searchsorted(self.time_ns, time_ns, side="right")) - 1)
        return float(self.density_kg_m3[place]), float(self.sigma_kg_m3[place])


def make_unknown_density() -> Density:
    """Return the density of an unknown material: NaN."""
    return Density.constant(float("nan"), float("nan"))
