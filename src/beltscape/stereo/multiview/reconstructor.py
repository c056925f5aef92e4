"""The multi-view reconstructor: one depth map in the core's view from all auxiliaries."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from typing import NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.arguments import require_depth_range
from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.kernels import Kernels, load
from beltscape.kernels.planes import FoundPixels, find_plane_kernels, repeat_blocks, to_processor
from beltscape.stereo.cameras import check_auxiliaries, list_usable_auxiliaries
from beltscape.stereo.multiview.candidates import (
    PIXEL_FEATURES,
    CandidateSelector,
    Selection,
    begin_selection,
    finish_selection,
)
from beltscape.stereo.multiview.estimate import (
    DepthEstimate,
    PredictedDepth,
    combine_estimate,
    predict_depth,
)
from beltscape.stereo.multiview.features import (
    ConfidenceInputs,
    MatcherState,
    compute_image_features,
    compute_selection_features,
)
from beltscape.stereo.multiview.frame import MatchContext, PreparedFrame
from beltscape.stereo.multiview.optimisation import LeastSquaresResult, apply_twicing, solve_least_squares
from beltscape.stereo.multiview.parallel import run_pair
from beltscape.stereo.multiview.preparation import prepare_frame
from beltscape.stereo.multiview.pyramid import PyramidSolver
from beltscape.stereo.multiview.surface import Surface, upsample_surface
from beltscape.stereo.multiview.textureless import fill_textureless_discs
from beltscape.stereo.settings import MultiviewSettings

Number = TypeVar("Number", bound=np.number)


class MultiviewReconstructor:
    """The matcher for one rig and depth range; it reconstructs any number of frames."""

    def __init__(
        self,
        rig: Rig,
        depth_range_mm: tuple[float, float],
        settings: MultiviewSettings,
        *,
        auxiliaries: tuple[str, ...] | None = None,
        kernels: Kernels | None = None,
    ) -> None:
        """Prepare ``auxiliaries`` (all of the rig by default) for surfaces within (near, far) in mm.

        Raises
        ------
        ReconstructionError, InputError, SettingsError
            When an auxiliary is not in the rig, or a value is invalid.
        """
        require_depth_range(depth_range_mm)
        names = check_auxiliaries(rig, auxiliaries)
        settings = settings.revalidate()
        self.rig = rig
        self.depth_range_mm = depth_range_mm
        self.settings = settings
        self._auxiliaries = names
        self._step = settings.step(rig.core_camera.size_px[0])
        self._kernels = kernels or load()

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter) -> DepthMap:
        """Return the depth map of one frame; auxiliaries without an image are left out.

        The result depends on the frame's images only, and on no other frame.

        Raises
        ------
        ReconstructionError
            When the core's image or every auxiliary's is missing.
        """
        return self._kernels.run_resident(
            lambda kernels: self._use(kernels)._estimate_depth_map(frame_set, reporter)
        )

    def _use(self, kernels: Kernels) -> MultiviewReconstructor:
        """Return this matcher with other kernels."""
        other = copy(self)
        other._kernels = kernels
        return other

    def _estimate_depth_map(self, frame_set: FrameSet, reporter: Reporter) -> DepthMap:
        names = list_usable_auxiliaries(self.rig, frame_set, self._auxiliaries)
        state = self.match(frame_set, names, reporter)
        predicted, context = predict_depth(state), state.prepared.context
        planes = context.kernels.replay(_combine_planes, predicted, context, self.settings.least_confidence)
        return _pad_planes(planes, context)

    def match(self, frame_set: FrameSet, names: tuple[str, ...], reporter: Reporter) -> MatcherState:
        """Return the final surface of one frame; each step is reported."""
        grids = self.settings.grids(self.rig.core_camera.size_px[0])
        on_step = _StepCounter(reporter, frame_set.frame, grids + 3)
        state = self.solve_pyramid(frame_set, names, on_step)
        solution, prepared = state.solution, state.prepared
        selection, discs = run_pair(
            lambda: self._select(state),
            lambda: fill_textureless_discs(solution.surface, solution.information, prepared),
            self.settings.threads,
        )
        on_step()
        surface = discs.surface
        if selection is not None:
            surface = selection.surface
            if discs.mask.any():
                surface = surface.replace_where(discs.mask, discs.surface)
        solution = self.solve_finally(surface, prepared)
        on_step()
        return replace(state, solution=solution, filled=discs.mask, selection=selection)

    def solve_pyramid(
        self, frame_set: FrameSet, names: tuple[str, ...], on_step: Callable[[], None] = lambda: None
    ) -> MatcherState:
        """Return the surface after the rounds of propagation, before the candidate selection."""
        threads = self.settings.threads
        context = MatchContext.for_grid(self.rig, names, self._step, self._kernels, threads)
        solver = PyramidSolver(self.depth_range_mm, self.settings, on_step)
        surface, prepared = solver.initialise(prepare_frame(frame_set, context))
        (propagated, solution), image = run_pair(
            lambda: solver.propagate(surface, prepared), lambda: compute_image_features(prepared), threads
        )
        unfilled = np.zeros(surface.s.shape, bool)
        return MatcherState(prepared, propagated, solution, image.planes, image.textured, unfilled, None)

    def _select(self, state: MatcherState) -> Selection | None:
        """Return the surface after the candidate selection of uncertain pixels; None without it."""
        if not self.settings.candidate_selection:
            return None
        return finish_selection(*state.prepared.context.kernels.replay(_begin_selection, state))

    def solve_finally(self, surface: Surface, prepared: PreparedFrame) -> LeastSquaresResult:
        """Return the surface after the last iteration."""
        iterate = _iterate_with_twicing if self.settings.twicing else _iterate
        return prepared.context.kernels.replay(iterate, surface, prepared, self.settings.final_tolerance_px)


def _begin_selection(state: MatcherState) -> tuple[CandidateSelector, FoundPixels | NDArray[np.bool_]]:
    """Return what the candidate selection begins with, from the features of the matched surface."""
    planes = compute_selection_features(ConfidenceInputs.from_state(state))
    chosen = {name: planes[name] for name in PIXEL_FEATURES}
    return begin_selection(state.solution.surface, chosen, state.prepared)


def _iterate(surface: Surface, prepared: PreparedFrame, tolerance_px: float) -> LeastSquaresResult:
    """Return the surface after the last iteration."""
    return solve_least_squares(surface, prepared, (tolerance_px,), prepared.context.windows.wide)


def _iterate_with_twicing(
    surface: Surface, prepared: PreparedFrame, tolerance_px: float
) -> LeastSquaresResult:
    """Return the surface after the last iteration, with its flattening corrected."""
    solution = _iterate(surface, prepared, tolerance_px)
    return replace(solution, surface=apply_twicing(solution.surface, prepared, tolerance_px))


class DepthPlanes(NamedTuple):
    """The planes (H, W) of a depth map without the last rows and columns that fill no block."""

    depth: NDArray[np.floating]
    """mm"""
    sigma_mm: NDArray[np.floating]
    views: NDArray[np.uint8]
    confidence: NDArray[np.floating]


def make_depth_map(estimate: DepthEstimate, context: MatchContext, least_confidence: float) -> DepthMap:
    """Return the depth of sufficiently confident pixels on the core's full grid."""
    return _pad_planes(_make_planes(estimate, context, least_confidence), context)


def _combine_planes(predicted: PredictedDepth, context: MatchContext, least_confidence: float) -> DepthPlanes:
    """Return the planes of the depth map for what the estimate is combined from."""
    return _make_planes(combine_estimate(predicted), context, least_confidence)


def _make_planes(estimate: DepthEstimate, context: MatchContext, least_confidence: float) -> DepthPlanes:
    """Return the planes of a depth map on the grid's whole blocks."""
    unit, step = context.inverse_depth_scale, context.step
    s = upsample_surface(estimate.surface, step)
    sigma, confidence, views = (
        _repeat_blocks(x, step) for x in (estimate.sigma, estimate.confidence, estimate.views)
    )
    accepted = (confidence >= least_confidence) & (s > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(accepted, 1 / (s * np.float32(unit)), np.float32(np.nan))
        sigma_mm = (depth * depth * np.float32(unit) * sigma).astype(np.float32, copy=False)
    return DepthPlanes(
        depth,
        sigma_mm,
        np.where(accepted, views, np.uint8(0)),
        np.where(accepted, confidence, np.float32(0)),
    )


def _pad_planes(planes: DepthPlanes, context: MatchContext) -> DepthMap:
    """Return the depth map of the core's full grid."""
    size_px = context.rig.core_camera.size_px
    return DepthMap(
        _pad(to_processor(planes.depth), size_px, np.nan),
        _pad(to_processor(planes.sigma_mm), size_px, np.nan),
        _pad(to_processor(planes.views), size_px, 0),
        _pad(to_processor(planes.confidence), size_px, 0),
    )


def _repeat_blocks(values: NDArray[Number], step: int) -> NDArray[Number]:
    """Return every value repeated over its block."""
    if step == 1:
        return values
    height, width = values.shape
    if find_plane_kernels(values):
        repeated = repeat_blocks(values.astype(np.float32, copy=False), step, (height * step, width * step))
        return repeated.astype(values.dtype, copy=False)
    return cv2.resize(values, (width * step, height * step), interpolation=cv2.INTER_NEAREST)


def _pad(plane: NDArray[Number], size_px: tuple[int, int], value: float) -> NDArray[Number]:
    """Return the plane with ``value`` in the last rows and columns of the image, which have no whole block."""
    width, height = size_px
    if plane.shape == (height, width):
        return plane
    missing = (0, height - plane.shape[0]), (0, width - plane.shape[1])
    return np.pad(plane, missing, constant_values=value)


class _StepCounter:
    """A callback that counts one frame's steps and reports them."""

    def __init__(self, reporter: Reporter, frame: str, total: int) -> None:
        self._reporter, self._frame, self._total, self._done = reporter, frame, total, 0

    def __call__(self) -> None:
        self._done += 1
        self._reporter.step(f"matching {self._frame}", self._done, self._total)
