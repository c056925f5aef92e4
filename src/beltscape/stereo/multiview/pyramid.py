"""The coarse-to-fine pyramid: a plane sweep on the coarsest grid, then rounds of propagation on every grid.

Propagation reaches a fixed number of pixels, so on a grid of half the resolution it reaches twice as far at a quarter
of the cost. The next finer grid corrects what a coarse grid cannot represent, such as edges.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from beltscape.stereo.multiview.frame.frame import PreparedFrame, halve_frame
from beltscape.stereo.multiview.frame.surface import Surface, double_surface, fit_slopes
from beltscape.stereo.multiview.initialisation.initialise import SweepResolution, initialise_inverse_depth
from beltscape.stereo.multiview.optimisation.least_squares import LeastSquaresResult, solve_least_squares
from beltscape.stereo.multiview.optimisation.noise import estimate_noise
from beltscape.stereo.multiview.optimisation.propagation import PropagationResult, propagate
from beltscape.stereo.multiview.settings import MultiviewSettings

_FIRST_PX = 2.0, 2.0
"""Tolerances of the iterations on the sweep's surface."""
_CHANGED_PX, _SETTLED = 0.5, 0.003
"""Propagation ends on a grid when less than this share of the pixels changes by more than this."""


@dataclass(frozen=True, slots=True)
class PyramidSolver:
    """Depth range and settings for solving one frame coarse to fine."""

    depth_range_mm: tuple[float, float]
    settings: MultiviewSettings
    on_step: Callable[[], None]
    """Called after the sweep, and after every grid."""

    def initialise(self, prepared: PreparedFrame) -> tuple[Surface, PreparedFrame]:
        """Return the first surface on a grid, from the next coarser grid or else a sweep.

        The frame is returned with the noise estimated from this surface's residuals.
        """
        has_coarser = self.settings.has_coarser_grid(prepared.core.shape[1])
        surface = self._solve_half(prepared) if has_coarser else self._sweep(prepared)
        return surface, replace(prepared, noise=estimate_noise(surface, prepared))

    def propagate(
        self, surface: Surface, prepared: PreparedFrame
    ) -> tuple[PropagationResult, LeastSquaresResult]:
        """Return the last of the rounds of propagation and least squares, which end when hardly a pixel changes."""
        settings = self.settings
        distances, narrow = settings.offsets_px(prepared.context.scale), prepared.context.windows.narrow
        for turn in range(settings.rounds):
            alternating = turn if settings.rounds > 1 else None
            propagated = propagate(surface, prepared, distances, alternating)
            solution = solve_least_squares(propagated.surface, prepared, settings.round_tolerances_px, narrow)
            if turn + 1 == settings.rounds or _compute_changed_share(surface, propagated.surface) < _SETTLED:
                self.on_step()
                return propagated, solution
            surface = solution.surface
        raise ValueError("propagation needs at least one round")

    def _solve_half(self, prepared: PreparedFrame) -> Surface:
        """Return the surface of the grid of half the resolution, enlarged."""
        _, solution = self.propagate(*self.initialise(halve_frame(prepared)))
        return double_surface(solution.surface, prepared.core.shape)

    def _sweep(self, prepared: PreparedFrame) -> Surface:
        """Return the optimised surface of a sweep."""
        settings, context = self.settings, prepared.context
        unit = context.inverse_depth_scale
        near, far = self.depth_range_mm
        resolution = SweepResolution(settings.shrink(prepared.core.shape[1]), settings.plane_step_px)
        s_range = 1 / (far * unit), 1 / (near * unit)
        s = initialise_inverse_depth(prepared, s_range, resolution)
        self.on_step()
        surface = fit_slopes(s, context.kernels, context.threads)
        return solve_least_squares(surface, prepared, _FIRST_PX, context.windows.narrow).surface


def _compute_changed_share(before: Surface, after: Surface) -> float:
    """Return the share of pixels whose s changed by more than `_CHANGED_PX`."""
    return np.count_nonzero(np.abs(after.s - before.s) > _CHANGED_PX) / after.s.size
