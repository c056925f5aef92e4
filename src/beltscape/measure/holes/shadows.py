"""Shadows on a height map: how high a hole cell may be and still be hidden from the core and the auxiliaries.

A point over a cell is hidden from a camera below the line of sight over the measured cells between them. A surface
that no camera has measured lies below one such line at least: below the core's, or below those of all auxiliaries.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import load
from beltscape.kernels.arrays import CellIndices

_VERTICAL = 1e-9
"""Slope below which a line of sight is vertical: nothing hides what lies on it."""


@dataclass(frozen=True, slots=True, eq=False)
class LinesOfSight:
    """The directions from which the cameras see a grid (Ny, Nx), and the surface that its heights stand on."""

    slope: NDArray[np.float64]
    """(1 + V, 2, Ny, Nx) slope of the rays of the core and of V auxiliaries from the vertical, in x and y, positive
    away from the camera."""
    ground_mm: NDArray[np.float64]
    """(Ny, Nx) height of the surface; only its differences count."""

    @property
    def core(self) -> NDArray[np.float64]:
        """Return the slopes (2, Ny, Nx) of the core's rays."""
        return self.slope[0]

    @classmethod
    def over(
        cls,
        eyes_mm: NDArray[np.float64],
        x_mm: NDArray[np.float64],
        y_mm: NDArray[np.float64],
        ground_mm: NDArray[np.float64],
    ) -> LinesOfSight:
        """Return those of cameras at positions (1 + V, 3), the core first, over the cells at x (Nx,) and y (Ny,)."""
        eye_x, eye_y, eye_z = eyes_mm.T[:, :, None, None]
        reach = np.maximum(eye_z - ground_mm, 1.0)
        return cls(np.stack([(x_mm - eye_x) / reach, (y_mm[:, None] - eye_y) / reach], axis=1), ground_mm)

    @classmethod
    def vertical(cls, shape: tuple[int, ...]) -> LinesOfSight:
        """Return those of a core that looks straight down everywhere, without auxiliaries, on a level surface."""
        return cls(np.zeros((1, 2, *shape)), np.zeros(shape))


def compute_shadow_heights(
    height_mm: NDArray[np.float64], cells: CellIndices, sight: LinesOfSight, cell_mm: float
) -> NDArray[np.float64]:
    """Return the height (1 + V, H), over the surface, below which each camera does not see the hole ``cells``.

    ``height_mm`` (Ny, Nx) are heights over the surface, NaN in holes. -inf where nothing hides a cell.
    """
    tan_x, tan_y = sight.slope[:, 0][:, *cells], sight.slope[:, 1][:, *cells]
    longest = np.maximum(np.abs(tan_x), np.abs(tan_y))  # a step goes to the next row or column
    vertical = longest < _VERTICAL
    unit = np.where(vertical, 1.0, longest)
    fall = np.where(vertical, np.inf, cell_mm / unit)
    found = load().shadow_heights(height_mm + sight.ground_mm, cells, -tan_y / unit, -tan_x / unit, fall)
    return found - sight.ground_mm[cells]


def summarise_shadows(shadow_mm: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return the (H,) heights below which the core, all auxiliaries, all but one, and any of them see nothing.

    With one auxiliary "all but one" is that of none: as high as can be. Without any auxiliary all are -inf.
    """
    core, others = shadow_mm[0], np.sort(shadow_mm[1:], axis=0)
    none = np.full(core.shape, -np.inf)
    return {
        "core": core,
        "all": others[0] if len(others) else none,
        "all but one": others[1] if len(others) > 1 else np.full(core.shape, np.inf if len(others) else -np.inf),
        "any": others[-1] if len(others) else none,
    }
