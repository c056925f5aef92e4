"""The true volume of the load: the space between the belt and the surface seen from vertically above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.simulate.geometry.ray_casting import RayScene
from beltscape.simulate.geometry.world import Label, World

_ABOVE_MM = 100.0
"""Height of the ray origins above the highest vertex."""
_DOWN = (0.0, 0.0, -1.0)
"""Direction of the rays, in the world's frame."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueLoad:
    """The load over a box of the belt, vertical in the world; overhangs count as solid."""

    x_mm: NDArray[np.float64]
    """(Nx,) centres of the cells."""
    y_mm: NDArray[np.float64]
    """(Ny,)."""
    height_mm: NDArray[np.float64]
    """(Ny, Nx) height above the empty belt, never below 0; 0 beside the belt."""
    across_mm: tuple[float, float]
    """Extent of the box in x."""
    along_mm: tuple[float, float]
    """Extent of the box in y."""

    @property
    def volume_mm3(self) -> float:
        """Return the integral over the box, by the midpoint rule."""
        return float(self.height_mm.mean()) * self._surface_mm2

    @property
    def spread_mm3(self) -> float:
        """Return the standard deviation of the volumes from each fourth cell: an upper bound of the error of all."""
        parts = [self.height_mm[j::2, i::2].mean() for j in (0, 1) for i in (0, 1)]
        return float(np.std(parts, ddof=1)) * self._surface_mm2

    @property
    def area_mm2(self) -> NDArray[np.float64]:
        """Return (Ny,) the cross-section of the load at each y."""
        return self.height_mm.mean(axis=1) * (self.across_mm[1] - self.across_mm[0])

    @property
    def _surface_mm2(self) -> float:
        (left, right), (first, last) = self.across_mm, self.along_mm
        return (right - left) * (last - first)


def compute_true_load(
    world: World, across_mm: tuple[float, float], along_mm: tuple[float, float], step_mm: float = 0.5
) -> TrueLoad:
    """Measure the load by vertical rays to the world and to its belt alone, one for every cell of about ``step_mm``.

    Everything but belt, floor and what has no label counts as load where it lies above the belt.
    """
    x, y = (_cell_centres(*ends, step_mm) for ends in (across_mm, along_mm))
    return TrueLoad(x, y, _load_heights(world, x, y), across_mm, along_mm)


def compute_true_area_mm2(
    world: World, y_mm: NDArray[np.float64], across_mm: tuple[float, float], step_mm: float = 0.25
) -> NDArray[np.float64]:
    """Return (N,) the load's exact cross-section at positions along the belt (N,)."""
    heights = _load_heights(world, _cell_centres(*across_mm, step_mm), np.asarray(y_mm, np.float64))
    return heights.mean(axis=1) * (across_mm[1] - across_mm[0])


def _load_heights(world: World, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (Ny, Nx) heights of the load above the belt."""
    x, y = np.meshgrid(x_mm, y_mm)
    solids = [solid for solid in world.solids if solid.label != Label.NOTHING]
    high = max(float(solid.vertices_mm[:, 2].max()) for solid in solids) + _ABOVE_MM
    eyes = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, high)])
    scene = RayScene(solids)
    loaded = scene.cast(eyes, np.broadcast_to(_DOWN, eyes.shape))
    is_covered = loaded.face >= 0
    is_covered[is_covered] = scene.label_of_face[loaded.face[is_covered]] != Label.BELT
    rest = eyes[is_covered]
    belt = RayScene([solid for solid in world.solids if solid.label == Label.BELT])
    below = belt.cast(rest, np.broadcast_to(_DOWN, rest.shape)).distance
    height = np.zeros(x.size)
    height[is_covered] = np.where(
        np.isfinite(below), np.maximum(below - loaded.distance[is_covered], 0.0), 0.0
    )
    return height.reshape(x.shape)


def _cell_centres(first: float, last: float, step_mm: float) -> NDArray[np.float64]:
    """Return (N,) centres of an even number of equal cells."""
    count = 2 * max(1, int(np.ceil((last - first) / step_mm / 2 - 1e-9)))
    return first + (np.arange(count, dtype=np.float64) + 0.5) / count * (last - first)
