"""One reconstruction in the core's frame from all auxiliaries at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.arguments import require_depth_range
from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Reporter
from beltscape.core.rig import Rig
from beltscape.kernels import Kernels, load
from beltscape.stereo.cameras import check_auxiliaries, usable_auxiliaries
from beltscape.stereo.multiview.confidence.estimate import (
    DepthEstimate,
    estimate_depth,
    initial_features,
    with_initial_confidence,
)
from beltscape.stereo.multiview.confidence.features import image_features
from beltscape.stereo.multiview.confidence.refined_features import initial_confidence_features
from beltscape.stereo.multiview.frame.frame import PreparedFrame, grid_unit, prepare_frame
from beltscape.stereo.multiview.frame.parallel import run_pair
from beltscape.stereo.multiview.frame.surface import Surface, upsample_surface
from beltscape.stereo.multiview.frame.windows import windows_for
from beltscape.stereo.multiview.initialisation.temporal_prior import Prior
from beltscape.stereo.multiview.optimisation.least_squares import RefinementResult, refine
from beltscape.stereo.multiview.optimisation.textureless import fill_textureless_discs
from beltscape.stereo.multiview.optimisation.twicing import apply_twicing
from beltscape.stereo.multiview.pyramid import PyramidSolver
from beltscape.stereo.multiview.selection.candidates import Selection, select_candidates
from beltscape.stereo.multiview.settings import MultiviewSettings
from beltscape.stereo.multiview.state import MatcherState

Number = TypeVar("Number", bound=np.number)


class MultiviewReconstructor:
    """The matcher for a rig and a depth range, used for every frame."""

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
            When one of them is not in the rig, or a value does not fit.
        """
        require_depth_range(depth_range_mm)
        names = check_auxiliaries(rig, auxiliaries)
        settings = settings.checked()
        self.rig = rig
        self.depth_range_mm = depth_range_mm
        self.settings = settings
        self._auxiliaries = names
        self._step = settings.step(rig.core_camera.size_px[0])
        self._kernels = kernels or load()

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter, *, prior: Prior | None = None) -> DepthMap:
        """Depth of one frame; auxiliaries without an image are gone without.

        With a ``prior``, the frame before and the belt's motion since, only what that does not explain is swept.

        Raises
        ------
        ReconstructionError
            When the core's image or every auxiliary's is missing.
        """
        names = usable_auxiliaries(self.rig, frame_set, self._auxiliaries)
        unit = grid_unit(self.rig, names, self._step)
        match = self.match(frame_set, names, reporter, prior)
        scale = windows_for(match.prepared.core.shape[1]).scale
        verdict = estimate_depth(match, scale, self._kernels, self.settings.threads)
        return _depth_map(
            replace(match.refined.surface, s=verdict.s),
            verdict,
            unit,
            self._step,
            self.settings.least_confidence,
            self.rig.core_camera.size_px,
        )

    def match(
        self, frame_set: FrameSet, names: tuple[str, ...], reporter: Reporter, prior: Prior | None = None
    ) -> MatcherState:
        """The surface of one frame before it is judged; told of in steps."""
        threads = self.settings.threads
        grids = self.settings.grids(self.rig.core_camera.size_px[0])
        tell = _Steps(reporter, frame_set.frame, grids + 3)
        before = self.approach(frame_set, names, tell, prior)
        chosen, refined, prepared = before.chosen, before.refined, before.prepared
        size = windows_for(prepared.core.shape[1])
        contested, discs = run_pair(
            lambda: self._looked_at_again(before, size.scale),
            lambda: fill_textureless_discs(refined.surface, refined.information, prepared, size.scale),
            threads,
        )
        tell()
        surface = discs.surface
        if contested is not None:
            surface = contested.surface.where(discs.inside, discs.surface)
        refined = self._finished(surface, prepared)
        tell()
        return MatcherState(prepared, chosen, refined, before.light, discs.inside, contested)

    def _finished(self, surface: Surface, prepared: PreparedFrame) -> RefinementResult:
        """The surface after the last iterations."""
        settings, kernels, threads = self.settings, self._kernels, self.settings.threads
        size = windows_for(prepared.core.shape[1])
        *before, last = settings.final_px
        if before:
            surface = refine(
                surface, prepared, tuple(before), size.firm, size.levels_px, kernels, threads
            ).surface
        refined = refine(surface, prepared, (last,), size.wide, size.levels_px, kernels, threads)
        if not settings.sharpen:
            return refined
        return replace(
            refined, surface=apply_twicing(refined.surface, prepared, last, size, kernels, threads)
        )

    def _looked_at_again(self, before: MatcherState, scale: float) -> Selection | None:
        """The surface after closer looks at doubtful pixels; None without any."""
        settings, kernels, threads = self.settings, self._kernels, self.settings.threads
        if not settings.contests:
            return None
        planes = with_initial_confidence(
            initial_features(before, scale, kernels, threads), scale, kernels, threads
        )
        contested = select_candidates(
            before.refined.surface, planes, before.prepared, scale, kernels, threads
        )
        for _ in range(settings.contests - 1):
            planes = planes | dict(initial_confidence_features(contested.impression, scale))
            contested = select_candidates(contested.surface, planes, before.prepared, scale, kernels, threads)
        return contested

    def approach(
        self,
        frame_set: FrameSet,
        names: tuple[str, ...],
        tell: Callable[[], None] = lambda: None,
        prior: Prior | None = None,
    ) -> MatcherState:
        """The surface after the rounds of propagation, before doubtful pixels are looked at again."""
        settings, kernels, threads = self.settings, self._kernels, self.settings.threads
        way = PyramidSolver(self.rig, names, self.depth_range_mm, settings, prior, kernels, tell)
        surface, prepared = way.begun(
            prepare_frame(self.rig, frame_set, names, self._step, kernels, threads), self._step
        )
        scale = windows_for(prepared.core.shape[1]).scale
        (chosen, refined), light = run_pair(
            lambda: way.rounds(surface, prepared),
            lambda: dict(image_features(prepared, scale)),
            threads,
        )
        return MatcherState(prepared, chosen, refined, light, np.zeros(surface.s.shape, bool), None)


class _Steps:
    """Tells a reporter of one frame's steps."""

    def __init__(self, reporter: Reporter, frame: str, total: int) -> None:
        self._reporter, self._frame, self._total, self._done = reporter, frame, total, 0

    def __call__(self) -> None:
        self._done += 1
        self._reporter.step(f"matching {self._frame}", self._done, self._total)


def _depth_map(
    surface: Surface,
    verdict: DepthEstimate,
    unit: float,
    step: int,
    least_confidence: float,
    size_px: tuple[int, int],
) -> DepthMap:
    """Depth of the believed pixels on the core's full grid."""
    s = upsample_surface(surface, step)
    sigma, confidence, views = (
        _repeated(x, step) for x in (verdict.sigma, verdict.confidence, verdict.views)
    )
    believed = (confidence >= least_confidence) & (s > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(believed, 1 / (s * np.float32(unit)), np.nan).astype(np.float32)
        sigma_mm = (depth * depth * np.float32(unit) * sigma).astype(np.float32)
    width, height = size_px
    whole = [np.full((height, width), empty, dtype) for empty, dtype in _EMPTY]
    parts = depth, sigma_mm, np.where(believed, views, 0), np.where(believed, confidence, 0)
    for target, part in zip(whole, parts, strict=True):
        target[: part.shape[0], : part.shape[1]] = part
    return DepthMap(*whole)


_EMPTY = ((np.nan, np.float32), (np.nan, np.float32), (0, np.uint8), (0, np.float32))
"""Depth, sigma, views, confidence of what was not measured: also a last row or column no block holds."""


def _repeated(values: NDArray[Number], step: int) -> NDArray[Number]:
    """Every value over its block."""
    if step == 1:
        return values
    height, width = values.shape
    return cv2.resize(values, (width * step, height * step), interpolation=cv2.INTER_NEAREST)
