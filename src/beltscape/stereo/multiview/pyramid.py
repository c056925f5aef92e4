"""The coarse-to-fine pyramid: a plane sweep on the coarsest grid, then rounds of propagation on every grid.

Propagation reaches a fixed number of pixels, so on a grid of half the resolution it reaches twice as far at a quarter
of the cost. The next finer grid corrects what a coarse grid cannot represent, such as edges.

On the coarsest grid the range of the sweep is narrowed by coarse matching where it is wide. The frame's noise is
estimated once, from the residuals of the first surface:

Levels of the core and an auxiliary, normalised in a window, differ with the variance

    levels (1 / variance_I + 1 / variance_J) + model.

The first part comes from the sensors, the second from sampling, gloss and other model errors. The residuals of an
approximate surface, where there is texture, give a common factor for both.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Floats
from beltscape.core.statistics import CHI2_MEDIAN, compute_median
from beltscape.kernels.planes import to_single
from beltscape.kernels.statistics import find_statistics_kernels
from beltscape.stereo.multiview.depth_range import (
    compute_robust_range,
    find_reliable_matches,
    shrink_frame,
    sweep_planes,
)
from beltscape.stereo.multiview.frame import MatchContext, Noise, PreparedFrame, Radii, halve_frame
from beltscape.stereo.multiview.optimisation import (
    LeastSquaresResult,
    PropagationResult,
    propagate,
    solve_least_squares,
)
from beltscape.stereo.multiview.parallel import run_parallel
from beltscape.stereo.multiview.photometry import compute_local_moments
from beltscape.stereo.multiview.surface import (
    Surface,
    crop_projection,
    double_surface,
    enlarge_blocks,
    fit_slopes,
)
from beltscape.stereo.settings import MultiviewSettings

_MANY_PLANES = 96
"""Number of planes above which coarse matching narrows the range first; that costs a fortieth of a sweep."""
_NARROWING = 4, 2
"""Factors by which the images of coarse matching are smaller than the sweep's, in the order in which they are tried.
On the scenes with dots of `benchmarks/axes.py` 4 finds the range of 2, to 5 planes, at a sixth of its time."""


@dataclass(frozen=True, slots=True)
class SweepResolution:
    """Resolution of a plane sweep."""

    shrink: int
    """Factor by which the sweep's images are smaller than the matcher's grid."""
    plane_step_px: float
    """Distance of the planes in pixels of the sweep's images."""

    @property
    def plane_step(self) -> float:
        """Distance of the planes in s."""
        return self.plane_step_px * self.shrink


def initialise_inverse_depth(
    prepared: PreparedFrame, s_range: tuple[float, float], resolution: SweepResolution
) -> NDArray[np.float32]:
    """Return (H, W) inverse depth s of a plane sweep within ``s_range`` = (far, near)."""
    if _is_wide(s_range, resolution):
        s_range = _narrow_range(prepared, s_range, resolution)
    swept, _ = sweep_planes(shrink_frame(prepared, resolution.shrink), s_range, resolution.plane_step)
    return enlarge_blocks(swept, resolution.shrink, prepared.core.shape)


def _is_wide(s_range: tuple[float, float], resolution: SweepResolution) -> bool:
    """Return whether coarse matching narrows the range first, so that the planes depend on the images."""
    return s_range[1] - s_range[0] > _MANY_PLANES * resolution.plane_step


def _narrow_range(
    prepared: PreparedFrame, s_range: tuple[float, float], resolution: SweepResolution
) -> tuple[float, float]:
    """Return the (far, near) part of ``s_range`` that holds the reliable matches on smaller images than the sweep's.

    It is wider than they are by half the distance of their planes. The result is all of ``s_range`` when there are
    too few of them.
    """
    context = prepared.context
    for factor in _NARROWING:
        small = shrink_frame(prepared, factor * resolution.shrink)
        splines = tuple(
            context.kernels.spline_coefficients(image, threads=context.threads) for image in small.images
        )
        step = factor * resolution.plane_step
        matches = find_reliable_matches(replace(small, coefficients=splines), s_range, step)
        found = compute_robust_range(matches)
        if found is not None:
            return max(found[0] - step / 2, s_range[0]), min(found[1] + step / 2, s_range[1])
    return s_range


_BANDS, _ROWS = 4, 64
"""Number of bands that are examined, and of rows in each."""
_MANY_VIEWS = 4
"""Number of views from which on each band is compared with every second one, in turn: half the time."""
_SCALE = (1 / 16, 64.0)
"""Range of the factor, since the surface may be wrong."""


def estimate_noise(surface: Surface, prepared: PreparedFrame) -> Noise:
    """Return the prepared frame's noise, scaled to the residuals of all views on a few bands of rows.

    Its numbers are on a GPU where the surface is.
    """
    s, noise = surface.s, prepared.noise
    bands = np.linspace(0, max(0, len(s) - _ROWS), _BANDS).astype(int)
    apart = 2 if len(prepared.views) >= _MANY_VIEWS else 1
    jobs = [
        partial(_compute_squared_residuals, s, prepared, int(first), slice(number % apart, None, apart))
        for number, first in enumerate(bands)
    ]
    ratios = [each for band in run_parallel(jobs, prepared.context.threads) for each in band]
    scale = _find_scale(ratios)
    return replace(noise, levels=noise.levels * scale, model=noise.model * scale)


def _find_scale(ratios: list[Floats]) -> Any:
    """Return the factor that makes squared residuals over their variance those of a normal distribution."""
    kernels = find_statistics_kernels(ratios[0])
    if kernels:
        ratio = kernels.find_quantile(ratios, 0.5) / CHI2_MEDIAN
        return np.where(np.isfinite(ratio), np.clip(ratio, *_SCALE), np.float32(1))
    found = np.concatenate(ratios)
    return float(np.clip(to_single(compute_median(found)) / CHI2_MEDIAN, *_SCALE)) if found.size else 1.0


def _compute_squared_residuals(s: Floats, prepared: PreparedFrame, first: int, views: slice) -> list[Floats]:
    """Return the squared residuals of some views over their variance, for the more textured half of a band."""
    rows = slice(first, first + _ROWS)
    noise, context = prepared.noise, prepared.context
    core, core_with_gaps = prepared.filled_core[rows], prepared.core[rows]
    core_level, core_variance = _normalise(core, noise.floor)
    textured = np.isfinite(core_with_gaps) & (core_variance >= _find_median(core_variance))
    band = s[rows]
    residuals: list[Floats] = []
    for view, coefficients in zip(prepared.views[views], prepared.coefficients[views], strict=True):
        warped, _ = context.kernels.warp(band, crop_projection(view, 0, first), coefficients, threads=1)
        valid = np.isfinite(warped)
        level, variance = _normalise(np.where(valid, warped, core), noise.floor)
        expected = to_single(noise.levels) * (1 / core_variance + 1 / variance) + to_single(noise.model)
        residuals.append(_take(np.square(core_level - level) / expected, valid & textured))
    return residuals


def _find_median(values: Floats) -> Any:
    kernels = find_statistics_kernels(values)
    return kernels.find_quantile([values], 0.5) if kernels else compute_median(values)


def _take(values: Floats, mask: NDArray[np.bool_]) -> Floats:
    """Return the values (N,) in a mask; on a GPU all of them (H, W), with NaN outside the mask."""
    return np.where(mask, values, np.float32(np.nan)) if find_statistics_kernels(values) else values[mask]


def _normalise(level: Floats, floor: float) -> tuple[Floats, Floats]:
    mean, variance = compute_local_moments(level)
    variance = variance + to_single(floor)
    return (level - mean) / np.sqrt(variance), variance


_FIRST_PX = 2.0, 2.0
"""Tolerances of the iterations on the sweep's surface."""
_CHANGED_PX, _SETTLED = 0.5, 0.003
"""Propagation ends on a grid when less than this share of the pixels changes by more than this."""


Beginning = tuple[tuple[PreparedFrame, ...], Surface]
"""A frame on coarser and coarser grids, and a surface on the last of them, by which its noise is known."""


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
        kernels = prepared.context.kernels
        halvings, coarsest = self._find_coarsest(prepared)
        begin, given = self._begin(prepared, halvings, coarsest)
        if halvings == 0:
            frames, surface = kernels.replay(begin, *given)
            self.on_step()
            return surface, frames[0]
        frames, _, solution = self._propagate(begin, given, coarsest)
        self.on_step()
        for finer in frames[-2:0:-1]:
            _, _, solution = self._propagate(_enlarge, (solution.surface, finer), finer.context)
        frames, surface = kernels.replay(_enlarge, solution.surface, prepared)
        return surface, frames[0]

    def propagate(
        self, surface: Surface, prepared: PreparedFrame
    ) -> tuple[PropagationResult, LeastSquaresResult]:
        """Return the last of the rounds of propagation and least squares, which end when hardly a pixel changes."""
        return self._propagate(_take_given, (surface, prepared), prepared.context)[1:]

    def _propagate(
        self, begin: Callable[..., Beginning], given: tuple[Any, ...], context: MatchContext
    ) -> tuple[tuple[PreparedFrame, ...], PropagationResult, LeastSquaresResult]:
        """Return the frames that ``begin`` returns for ``given``, and what `propagate` does from its surface.

        The context is that of the last of the frames.
        """
        settings, replay = self.settings, context.kernels.replay
        distances, narrow = settings.offsets_px(context.scale), context.windows.narrow

        def of(turn: int) -> tuple[Callable[..., Any], tuple[Any, ...]]:
            alternating = turn % 2 if settings.rounds > 1 else None
            run = _run_and_compare_round if turn + 1 < settings.rounds else _run_round
            return run, (distances, alternating, settings.round_tolerances_px, narrow)

        frames, propagated, solution, *changed = replay(_begin_and_run, begin, given, *of(0))
        for turn in range(1, settings.rounds):
            if float(changed[0]) < _SETTLED:  # the processor waits for it
                break
            run, of_round = of(turn)
            propagated, solution, *changed = replay(run, solution.surface, frames[-1], *of_round)
        self.on_step()
        return frames, propagated, solution

    def _find_coarsest(self, prepared: PreparedFrame) -> tuple[int, MatchContext]:
        """Return how often the frame's grid is halved, and the context of the coarsest one."""
        halvings, context = 0, prepared.context
        while self.settings.has_coarser_grid(prepared.core.shape[1] >> halvings):
            halvings, context = halvings + 1, context.halve()
        return halvings, context

    def _begin(
        self, prepared: PreparedFrame, halvings: int, coarsest: MatchContext
    ) -> tuple[Callable[..., Beginning], tuple[Any, ...]]:
        """Return the function that sweeps the coarsest grid, and what it is given."""
        settings = self.settings
        near, far = self.depth_range_mm
        width = prepared.core.shape[1] >> halvings
        resolution = SweepResolution(settings.shrink(width), settings.plane_step_px)
        s_range = 1 / (far * coarsest.inverse_depth_scale), 1 / (near * coarsest.inverse_depth_scale)
        if not _is_wide(s_range, resolution):
            return _halve_and_sweep, (prepared, halvings, s_range, resolution)
        frames = coarsest.kernels.replay(_halve, prepared, halvings)
        return _fit_swept_surface, (initialise_inverse_depth(frames[-1], s_range, resolution), frames)


def _take_given(surface: Surface, prepared: PreparedFrame) -> Beginning:
    """Return what is given."""
    return (prepared,), surface


def _begin_and_run(
    begin: Callable[..., Beginning],
    given: tuple[Any, ...],
    run: Callable[..., Any],
    of_round: tuple[Any, ...],
) -> Any:
    """Return the frames of a beginning, and the results of a round from its surface."""
    frames, surface = begin(*given)
    return frames, *run(surface, frames[-1], *of_round)


def _run_round(
    surface: Surface,
    prepared: PreparedFrame,
    distances_px: tuple[int, ...],
    turn: int | None,
    tolerances_px: tuple[float, ...],
    radii: Radii,
) -> tuple[PropagationResult, LeastSquaresResult]:
    """Return the surface after propagation, and after the least squares from there."""
    propagated = propagate(surface, prepared, distances_px, turn)
    return propagated, solve_least_squares(propagated.surface, prepared, tolerances_px, radii)


def _run_and_compare_round(
    surface: Surface, prepared: PreparedFrame, *settings: Any
) -> tuple[PropagationResult, LeastSquaresResult, Any]:
    """Return the results of `_run_round`, and the share of pixels that propagation changed."""
    propagated, solution = _run_round(surface, prepared, *settings)
    return propagated, solution, _compute_changed_share(surface, propagated.surface)


def _halve(prepared: PreparedFrame, halvings: int) -> tuple[PreparedFrame, ...]:
    """Return a frame and what it is on grids of half, a quarter ... of the resolution."""
    frames = [prepared]
    for _ in range(halvings):
        frames.append(halve_frame(frames[-1]))
    return tuple(frames)


def _halve_and_sweep(
    prepared: PreparedFrame, halvings: int, s_range: tuple[float, float], resolution: SweepResolution
) -> Beginning:
    """Return the frames of all grids and the first surface, from planes that do not depend on the images."""
    frames = _halve(prepared, halvings)
    return _fit_swept_surface(initialise_inverse_depth(frames[-1], s_range, resolution), frames)


def _enlarge(half: Surface, prepared: PreparedFrame) -> Beginning:
    """Return the surface of the grid of half the resolution on the prepared frame's."""
    surface = double_surface(half, prepared.core.shape)
    return (prepared.with_noise(estimate_noise(surface, prepared)),), surface


def _fit_swept_surface(s: NDArray[np.float32], frames: tuple[PreparedFrame, ...]) -> Beginning:
    """Return the first surface after the sweep of the last frame, which gave its inverse depth s (H, W)."""
    *finer, prepared = frames
    context = prepared.context
    surface = fit_slopes(s, context.kernels, context.threads)
    surface = solve_least_squares(surface, prepared, _FIRST_PX, context.windows.narrow).surface
    return (*finer, prepared.with_noise(estimate_noise(surface, prepared))), surface


def _compute_changed_share(before: Surface, after: Surface) -> Any:
    """Return the share of pixels whose s changed by more than `_CHANGED_PX`: a number, on a GPU where s is."""
    changed = np.abs(after.s - before.s) > _CHANGED_PX
    kernels = find_statistics_kernels(changed)
    if kernels:
        return kernels.average_plane(changed.astype(np.float32))
    return np.count_nonzero(changed) / after.s.size
