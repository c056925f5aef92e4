"""The check of the projector's position over the frames of a belt."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.live.findings import Finding, has_fault
from beltscape.health.images.surface_checks.projector_position import (
    LearnedPattern,
    PatternShift,
    check_projector_position,
    exceeds,
    measure_pattern_shift,
)
from beltscape.health.images.surface_checks.surface_samples import Surface, SurfaceGrid, Texture
from beltscape.health.settings import HealthSettings
from beltscape.measure.flow.fusion.empty_belt_reference import EmptyBeltReference

_PERIOD_NS = 500_000_000
"""Time between two checks; the second one confirms, so that a moved projector is named within a second."""
_EVERY = 4
"""Frames between two checks, for frames without times."""
_BARE_MM = 4.0
"""Largest height over the learned belt of a bare one: the pattern is displaced by up to 0.4 of it."""
_LEAST_SAMPLES = 3
"""Number of frames in which a cell must have been bare."""


class ProjectorMonitor:
    """Learns the pattern on the bare belt from the first sound frames, and compares it with later ones."""

    def __init__(
        self,
        rig: Rig,
        reference: EmptyBeltReference,
        settings: HealthSettings,
        learned: LearnedPattern | None = None,
        keep: Callable[[LearnedPattern], None] | None = None,
        grid: SurfaceGrid | None = None,
    ) -> None:
        """``learned`` is the pattern that an earlier run recognised; ``keep`` receives it once it was recognised.

        ``grid`` is one that other checks of the same frames use, too.
        """
        self._rig, self._reference, self._settings = rig, reference, settings
        self._grid = grid or SurfaceGrid(rig)
        self._belt_points = _intersect_belt(self._grid, reference)
        self._sums: dict[str, NDArray[np.float64]] = {}
        self._counts: dict[str, NDArray[np.float64]] = {}
        self._heights: list[float] = []
        self._keep = keep
        self._learned = learned if _fits(learned, self._belt_points, rig) else None
        self._has_passed, self._is_suspect = self._learned is not None, False
        self._number, self._last_ns = 0, 0
        self._fault: tuple[Finding, ...] = ()
        self._must_forget = False

    def learn_anew(self) -> None:
        """Forget the learned pattern, before the next frame is checked; any thread may call it."""
        self._must_forget = True

    def _forget(self) -> None:
        self._must_forget = False
        self._sums, self._counts, self._heights, self._learned = {}, {}, [], None
        self._has_passed, self._is_suspect, self._fault = False, False, ()

    def check(
        self, frames: FrameSet, depth: DepthMap | None, findings: Sequence[Finding]
    ) -> tuple[Finding, ...]:
        """Return the finding "projector_moved" of a checked frame; between two checks the fault, if there is one.

        ``findings`` are those about the frame's images and cameras: a frame with a fault is not learned, and a core
        camera that moved, or of which that is not known yet, sees a projector at rest displaced.
        """
        self._number += 1
        if self._must_forget:
            self._forget()
        if depth is None or self._settings.projector == "no" or not self._is_due(frames):
            return self._fault
        if has_fault(findings, "camera_pose", "", self._rig.core) or has_fault(
            findings, "camera_pose_unchecked", ""
        ):
            return self._fault
        view = self._grid.view(frames, depth)
        is_bare, height = self._find_bare_belt(view.surface)
        textures = view.filter_textures(self._rig.cameras)
        now = self._grid.sample_all(textures, self._belt_points)
        if self._learned is None:
            if self._settings.learning and not any(one.is_fault for one in findings):
                self._learn(now, is_bare, height)
            return ()
        cell = float(np.nanmedian(self._belt_points[..., 2])) / self._grid.cells_per_unit
        shift = measure_pattern_shift(self._learned, now, is_bare, height, cell, self._rig.core)
        return self._assess(shift)

    def _assess(self, shift: PatternShift) -> tuple[Finding, ...]:
        """Return the finding about a displacement; it must be confirmed, and the pattern recognised before."""
        is_beyond = exceeds(shift, self._settings)
        if not self._has_passed:
            self._has_passed = not is_beyond and bool(np.isfinite(shift.shift_mm))
            is_beyond = False
            if not self._has_passed:
                return ()
            if self._keep is not None and self._learned is not None:
                self._keep(self._learned)
        finding = check_projector_position(shift, self._is_suspect or bool(self._fault), self._settings)
        if np.isnan(shift.shift_mm) and self._fault:
            return self._fault
        self._is_suspect = is_beyond
        self._fault = (finding,) if finding.is_fault else ()
        return (finding,)

    def _is_due(self, frames: FrameSet) -> bool:
        if self._is_suspect:
            return True
        if frames.time_ns is None:
            return self._number % _EVERY == 0
        if abs(frames.time_ns - self._last_ns) < _PERIOD_NS and self._learned is not None:
            return False
        self._last_ns = frames.time_ns
        return True

    def _find_bare_belt(self, surface: Surface) -> tuple[NDArray[np.bool_], float]:
        """Return where the belt is bare (H, W), and its mean height over the learned one there."""
        belt = self._reference.belt
        points = belt.belt_from_core.apply(surface.points_mm)
        x, y = np.nan_to_num(points[..., 0]), np.nan_to_num(points[..., 1])
        height = points[..., 2] - belt.height_at_mm(x, y)
        low, high = belt.across_mm
        is_bare = surface.is_smooth & (np.abs(height) < _BARE_MM) & (x > low) & (x < high)
        return is_bare, float(height[is_bare].mean()) if is_bare.any() else float("nan")

    def _learn(self, now: dict[str, Texture], is_bare: NDArray[np.bool_], height_mm: float) -> None:
        for name, texture in now.items():
            known = is_bare & np.isfinite(texture)
            sums = self._sums.setdefault(name, np.zeros(is_bare.shape))
            sums[known] += texture[known]
            self._counts.setdefault(name, np.zeros(is_bare.shape))[known] += 1
        if np.isfinite(height_mm):
            self._heights.append(height_mm)
        if len(self._heights) < self._settings.learning_frames:
            return
        means = {
            name: np.where(
                self._counts[name] >= _LEAST_SAMPLES, sums / np.maximum(self._counts[name], 1), np.nan
            ).astype(np.float32)
            for name, sums in self._sums.items()
        }
        self._learned = LearnedPattern(means, float(np.median(self._heights)))
        self._sums, self._counts, self._heights = {}, {}, []


def _fits(learned: LearnedPattern | None, belt_points: NDArray[np.float64], rig: Rig) -> bool:
    """Return whether a kept pattern has the grid of this rig's images, and all its cameras."""
    if learned is None:
        return False
    sizes = {texture.shape for texture in learned.textures.values()}
    return sizes == {belt_points.shape[:2]} and set(rig.cameras) <= set(learned.textures)


def _intersect_belt(grid: SurfaceGrid, reference: EmptyBeltReference) -> NDArray[np.float64]:
    """Return the points (H, W, 3) of the learned empty belt on the rays of the grid, in the core's frame."""
    belt = reference.belt
    origin = belt.belt_from_core.translation_mm
    rays = grid.rays @ belt.belt_from_core.rotation.T
    distance = -origin[2] / rays[..., 2]
    for _ in range(4):
        x = origin[0] + distance * rays[..., 0]
        distance = (belt.height_mm(x) - origin[2]) / rays[..., 2]
    return grid.rays * distance[..., None]
