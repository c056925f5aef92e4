"""The way to a surface, coarse to fine: a sweep on the smallest grid, then on each grid rounds of propagation.

Propagation reaches so many pixels: on a grid half as fine twice as far, at a quarter of the cost. What a coarse grid
can not hold, the edges, the next finer one sets right.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from beltscape.core.rig import Rig
from beltscape.kernels import Kernels
from beltscape.stereo.multiview.frame.frame import PreparedFrame, grid_unit, halve_frame
from beltscape.stereo.multiview.frame.surface import Surface, fit_slopes, upsample_surface
from beltscape.stereo.multiview.frame.windows import windows_for
from beltscape.stereo.multiview.initialisation.initialise import SweepGrid, initialise_inverse_depth
from beltscape.stereo.multiview.initialisation.plane_sweep import enlarge_blocks
from beltscape.stereo.multiview.initialisation.temporal_prior import Prior, predict_inverse_depth
from beltscape.stereo.multiview.optimisation.least_squares import RefinementResult, refine
from beltscape.stereo.multiview.optimisation.noise import estimate_noise
from beltscape.stereo.multiview.optimisation.propagation import PropagationResult, propagate
from beltscape.stereo.multiview.settings import MultiviewSettings

_FIRST_PX = 2.0, 2.0
"""Tolerance of the iteration on the sweep's surface."""
_CHANGED_PX, _SETTLED = 0.5, 0.003
"""A round that changes fewer pixels than that share by so much is the last of its grid."""


@dataclass(frozen=True, slots=True)
class PyramidSolver:
    """What one frame's surface is approached by."""

    rig: Rig
    auxiliaries: tuple[str, ...]
    depth_range_mm: tuple[float, float]
    settings: MultiviewSettings
    prior: Prior | None
    kernels: Kernels
    tell: Callable[[], None]
    """Called after the sweep, and after every grid."""

    def begun(self, prepared: PreparedFrame, step: int) -> tuple[Surface, PreparedFrame]:
        """A first surface on a grid of blocks of ``step`` px: that of the next coarser grid, or else the sweep's.

        With the frame prepared for it, whose noise this surface's residuals tell.
        """
        coarser = self.settings.halves(prepared.core.shape[1])
        surface = self._from_half(prepared, step) if coarser else self._swept(prepared, step)
        noise = estimate_noise(surface, prepared, self.kernels, self.settings.threads)
        return surface, replace(prepared, noise=noise)

    def rounds(self, surface: Surface, prepared: PreparedFrame) -> tuple[PropagationResult, RefinementResult]:
        """Rounds of propagation, each refined, until hardly anything changes: the last one."""
        settings, kernels, threads = self.settings, self.kernels, self.settings.threads
        size = windows_for(prepared.core.shape[1])
        distances = settings.offsets_px(size.scale)
        for turn in range(settings.rounds):
            alternating = turn if settings.rounds > 1 else None
            chosen = propagate(surface, prepared, distances, kernels, threads, alternating)
            refined = self._refined(chosen.surface, prepared, settings.between_px)
            if turn + 1 == settings.rounds or _changed(surface, chosen.surface) < _SETTLED:
                self.tell()
                return chosen, refined
            surface = refined.surface
        raise ValueError("propagation needs at least one round")

    def _from_half(self, prepared: PreparedFrame, step: int) -> Surface:
        """That of the grid half as fine, every block a plane."""
        half = halve_frame(prepared, self.rig, self.auxiliaries, step, self.kernels, self.settings.threads)
        _, refined = self.rounds(*self.begun(half, 2 * step))
        return _enlarged(refined.surface, prepared.core.shape)

    def _swept(self, prepared: PreparedFrame, step: int) -> Surface:
        """The refined surface of a sweep, or of the frame before where that fits."""
        settings, kernels, threads = self.settings, self.kernels, self.settings.threads
        unit = grid_unit(self.rig, self.auxiliaries, step)
        near, far = self.depth_range_mm
        moved = None
        if self.prior is not None:
            moved = predict_inverse_depth(self.prior, self.rig, prepared, unit, step, kernels, threads)
        shrink = settings.shrink(prepared.core.shape[1])
        sweeps = SweepGrid(self.rig, self.auxiliaries, step, shrink, settings.plane_step_px, unit)
        s = initialise_inverse_depth(
            moved, prepared, (1 / (far * unit), 1 / (near * unit)), sweeps, kernels, threads
        )
        self.tell()
        return self._refined(fit_slopes(s, kernels, threads), prepared, _FIRST_PX).surface

    def _refined(
        self, surface: Surface, prepared: PreparedFrame, tolerances: tuple[float, ...]
    ) -> RefinementResult:
        size = windows_for(prepared.core.shape[1])
        return refine(
            surface, prepared, tolerances, size.narrow, size.levels_px, self.kernels, self.settings.threads
        )


def _changed(before: Surface, after: Surface) -> float:
    """Share of the pixels that moved."""
    return float(np.mean(np.abs(after.s - before.s) > _CHANGED_PX))


def _enlarged(surface: Surface, shape: tuple[int, ...]) -> Surface:
    """On a grid twice as fine, whose last row or column no block may hold; s counts that grid's pixels."""
    return Surface(
        enlarge_blocks(2 * upsample_surface(surface, 2), 1, shape),
        enlarge_blocks(surface.slope_u, 2, shape),
        enlarge_blocks(surface.slope_v, 2, shape),
    )
