"""Fig. 16: the gain in measured points by the projected speckle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltscape.evaluate.paper.surfaces import METHODS, REGION, ScoredDepth, Surfaces


@dataclass(frozen=True, slots=True, eq=False)
class Density:
    """One scene and method, with the projector on and off."""

    speckle: ScoredDepth
    dark: ScoredDepth

    @property
    def ratio(self) -> float:
        """Measured points with speckle over without, on the surface that the scene is about; inf over none."""
        return _ratio(self.speckle.points, self.dark.points)

    @property
    def right_ratio(self) -> float:
        """The ratio for the points within 1 mm of the truth."""
        return _ratio(self.speckle.right_points, self.dark.right_points)


def compute_density_gains(surfaces: Surfaces) -> tuple[Density, ...]:
    """Return the gain of every scene and method with both captures."""
    pairs = [((scene, method), (f"{scene}_nospeckle", method)) for scene in REGION for method in METHODS]
    return tuple(
        Density(surfaces[on], surfaces[off]) for on, off in pairs if on in surfaces and off in surfaces
    )


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else np.inf
