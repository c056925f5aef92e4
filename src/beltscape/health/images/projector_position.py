"""Position of the projector: the pattern on the bare belt, at its known height, against the learned pattern.

The monitor carries the check over the frames of a belt.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.alarm_catalogue import CAMERA_POSE, CAMERA_POSE_UNCHECKED, PROJECTOR_MOVED
from beltscape.core.depth import DepthMap
from beltscape.core.findings import Finding, has_fault
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.translatable_message import make_message
from beltscape.health.images.surface_samples import (
    SampledSurface,
    SurfaceGrid,
    SurfaceView,
    Texture,
    correlate_at_rest,
    find_peak,
    sample_at,
)
from beltscape.health.settings import HealthSettings
from beltscape.measure.belt.reference import EmptyBeltReference

SEARCH_CELLS = 24
"""Farthest displacement that is searched, cells; a pattern that moved farther counts as not found."""
_SIGMA_CELLS = 0.03
"""σ of the pattern's displacement, cells; sound captures scatter by 0.01."""
_PER_HEIGHT = 1.0
"""Displacement of the pattern per change of the belt's height: cameras and projector are within 45° of each other."""
_FOUND = 0.3
"""Correlation with the learned pattern from which its displacement is measured; sound captures: 0.7 to 0.95."""
_SAME_PATTERN = 0.45
"""Correlation between two cameras that both see the projected pattern, wherever it is; without projector: 0.1."""
_AGREEING = 2 / 3
"""Share of the cameras that must show the same displacement: a camera that moved shows it alone."""
_LEAST_BARE_SHARE = 0.01
"""Least share of the grid that is bare."""


@dataclass(frozen=True, slots=True, eq=False)
class LearnedPattern:
    """The mean texture of the bare belt while the projector was sound, on the grid of the core's view."""

    textures: Mapping[str, Texture]
    """Camera → texture (H, W) at the points of the learned empty belt; NaN: never seen bare."""
    height_mm: float
    """Mean height of the bare belt over the learned one."""


@dataclass(frozen=True, slots=True)
class PatternShift:
    """Displacement of the pattern on the bare belt."""

    shift_mm: float
    """Length of the displacement; infinite: the pattern is not found within the search; NaN: not measured."""
    sigma_mm: float
    allowance_mm: float
    """Displacement that a change of the belt's height may explain."""


UNMEASURED = PatternShift(float("nan"), float("nan"), float("nan"))


def measure_pattern_shift(
    learned: LearnedPattern,
    now: Mapping[str, Texture],
    is_bare: NDArray[np.bool_],
    height_mm: float,
    cell_mm: float,
    core: str,
) -> PatternShift:
    """Return the displacement of the pattern that most cameras show, on the half of the bare belt where it is larger.

    A projector that turned about its axis moves the pattern to opposite sides on the two halves.

    Parameters
    ----------
    learned
        The learned pattern.
    now
        The cameras' textures (H, W) at the points of the learned empty belt.
    is_bare
        (H, W) where the belt is bare at its learned height.
    height_mm
        Mean height there over the learned belt.
    cell_mm
        Width of a cell on the belt.
    core
        Name of the core camera.
    """
    if core not in now:
        return UNMEASURED
    allowance = _PER_HEIGHT * abs(height_mm - learned.height_mm)
    lengths = [_measure_length(learned, now, half, core) for half in _split(is_bare)]
    finite = [length for length in lengths if np.isfinite(length)]
    if finite:
        return PatternShift(cell_mm * max(finite), cell_mm * _SIGMA_CELLS, allowance)
    if lengths and all(np.isinf(length) for length in lengths):
        return PatternShift(float("inf"), SEARCH_CELLS * cell_mm, allowance)
    return UNMEASURED


def _split(is_bare: NDArray[np.bool_]) -> list[NDArray[np.bool_]]:
    """Return the left and the right half of the bare belt (H, W), those that are large enough."""
    if not is_bare.any():
        return []
    left = is_bare.copy()
    left[:, int(np.median(np.nonzero(is_bare)[1])) :] = False
    halves = left, is_bare & ~left
    return [half for half in halves if half.mean() >= _LEAST_BARE_SHARE]


def _measure_length(
    learned: LearnedPattern, now: Mapping[str, Texture], is_bare: NDArray[np.bool_], core: str
) -> float:
    """Return the displacement in cells; infinite: the pattern is projected elsewhere; NaN: not measured."""
    shifts: list[NDArray[np.float64]] = []
    lost = 0
    names = [name for name in now if name in learned.textures]
    for name in names:
        shift, correlation = find_peak(
            now[name], learned.textures[name], is_bare, SEARCH_CELLS, _LEAST_BARE_SHARE
        )
        if correlation >= _FOUND:
            shifts.append(-shift)
        elif name != core:
            rest = correlate_at_rest(now[core], now[name], is_bare, _LEAST_BARE_SHARE)
            lost += rest > _SAME_PATTERN
    if len(shifts) < 2:
        is_lost = len(names) > 2 and lost >= _AGREEING * (len(names) - 1)
        return float("inf") if is_lost else float("nan")
    middle = np.median(shifts, axis=0)
    length = float(np.linalg.norm(middle))
    agree = [float(np.linalg.norm(shift - middle)) < max(1.0, 0.3 * length) for shift in shifts]
    return length if np.mean(agree) >= _AGREEING else float("nan")


def check_projector_position(shift: PatternShift, is_confirmed: bool, settings: HealthSettings) -> Finding:
    """Return the finding "projector_moved": the displacement of the pattern on the bare belt, mm.

    Depth is measured with the pattern wherever it is, so that the finding has no effect on records.
    """
    limit = settings.projector_mm + (0.0 if np.isnan(shift.allowance_mm) else shift.allowance_mm)
    is_far = np.isinf(shift.shift_mm)
    value = shift.sigma_mm if is_far else shift.shift_mm
    finding = Finding(PROJECTOR_MOVED, value, shift.sigma_mm, limit, "mm")
    if not exceeds(shift, settings):
        return finding
    if not is_confirmed:
        return Finding(PROJECTOR_MOVED, float("nan"), shift.sigma_mm, limit, "mm")
    text = make_message("projector_far" if is_far else "projector_moved", shift=round(value, 1))
    return Finding(PROJECTOR_MOVED, value, shift.sigma_mm, limit, "mm", "", text)


def exceeds(shift: PatternShift, settings: HealthSettings) -> bool:
    """Return whether the displacement is beyond the limit, 3 σ and what the belt's height explains."""
    return shift.shift_mm > max(settings.projector_mm, 3 * shift.sigma_mm) + shift.allowance_mm


_BARE_MM = 4.0
"""Largest height over the learned belt of a bare one: the pattern is displaced by up to 0.4 of it."""


@dataclass(frozen=True, slots=True, eq=False)
class BareBelt:
    """The bare belt in one frame, and what the cameras show on it."""

    is_bare: NDArray[np.bool_]
    """(H, W) where the belt is bare at its learned height."""
    height_mm: float
    """Mean height there over the learned belt; NaN: nowhere bare."""
    cameras: tuple[str, ...]
    textures: Mapping[str, Texture]
    """Camera → texture (H, W) at the points of the learned empty belt; none where ``shift`` is measured."""
    shift: PatternShift | None
    """Displacement against the learned pattern; None without one."""


class BareBeltSampler:
    """Samples the bare belt in the frames of one rig."""

    def __init__(self, rig: Rig, reference: EmptyBeltReference, grid: SurfaceGrid) -> None:
        self._rig, self._reference, self._grid = rig, reference, grid
        self.points_mm = _intersect_belt(grid, reference)
        """(H, W, 3) points of the learned empty belt on the rays of the grid, in the core's frame."""
        self._places: dict[str, NDArray[np.float32]] = {}
        """Camera → where its texture shows these points."""

    def sample(self, view: SurfaceView, learned: LearnedPattern | None) -> BareBelt:
        """Return the bare belt in a frame, with the displacement of the ``learned`` pattern if there is one."""
        is_bare, height = self._find_bare_belt(view.surface)
        textures = view.filter_textures(self._rig.cameras)
        now = {name: sample_at(texture, self._locate(name)) for name, texture in textures.items()}
        if learned is None:
            return BareBelt(is_bare, height, tuple(now), now, None)
        cell = float(np.nanmedian(self.points_mm[..., 2])) / self._grid.cells_per_unit
        shift = measure_pattern_shift(learned, now, is_bare, height, cell, self._rig.core)
        return BareBelt(is_bare, height, tuple(now), {}, shift)

    def _locate(self, camera: str) -> NDArray[np.float32]:
        if camera not in self._places:
            self._places[camera] = self._grid.locate(camera, self.points_mm)
        return self._places[camera]

    def _find_bare_belt(self, surface: SampledSurface) -> tuple[NDArray[np.bool_], float]:
        """Return where the belt is bare (H, W), and its mean height over the learned one there."""
        belt = self._reference.belt
        points = belt.belt_from_core.apply(surface.points_mm)
        x, y = np.nan_to_num(points[..., 0]), np.nan_to_num(points[..., 1])
        height = points[..., 2] - belt.height_at_mm(x, y)
        low, high = belt.across_mm
        is_bare = surface.is_smooth & (np.abs(height) < _BARE_MM) & (x > low) & (x < high)
        return is_bare, float(height[is_bare].mean()) if is_bare.any() else float("nan")


_PERIOD_NS = 500_000_000
"""Time between two checks; the second one confirms, so that a moved projector is named within a second."""
_EVERY = 4
"""Frames between two checks, for frames without times."""
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
        self._rig, self._settings = rig, settings
        self._grid = grid or SurfaceGrid(rig)
        self._sampler = BareBeltSampler(rig, reference, self._grid)
        self._sums: dict[str, NDArray[np.float64]] = {}
        self._counts: dict[str, NDArray[np.float64]] = {}
        self._heights: list[float] = []
        self._keep = keep
        self._learned = learned if _fits(learned, self._sampler.points_mm, rig) else None
        self._has_passed, self._is_suspect = self._learned is not None, False
        self._number, self._last_ns, self._expected_ns = 0, 0, 0
        self._fault: tuple[Finding, ...] = ()
        self._must_forget = False

    def learn_anew(self) -> None:
        """Forget the learned pattern, before the next frame is checked; any thread may call it."""
        self._must_forget = True

    def _forget(self) -> None:
        self._must_forget = False
        self._sums, self._counts, self._heights, self._learned = {}, {}, [], None
        self._has_passed, self._is_suspect, self._fault = False, False, ()

    @property
    def learned(self) -> LearnedPattern | None:
        """Return the pattern that frames are compared with; None: it is being learned."""
        return self._learned

    def expects(self, frames: FrameSet) -> bool:
        """Return whether a frame set that is checked later will probably be compared; it is asked in their order."""
        if self._settings.projector == "no" or frames.time_ns is None:
            return False
        is_soon = abs(frames.time_ns - self._expected_ns) < _PERIOD_NS
        if is_soon and self._learned is not None and not self._is_suspect:
            return False
        self._expected_ns = frames.time_ns
        return True

    def check(
        self,
        frames: FrameSet,
        depth: DepthMap | None,
        findings: Sequence[Finding],
        sampled: BareBelt | None = None,
    ) -> tuple[Finding, ...]:
        """Return the finding "projector_moved" of a checked frame; between two checks the fault, if there is one.

        ``sampled`` is the result of `BareBeltSampler.sample` with the present learned pattern, where it is known.
        ``findings`` are those about the frame's images and cameras: a frame with a fault is not learned, and a core
        camera that moved, or of which that is not known yet, sees a projector at rest displaced.
        """
        self._number += 1
        if self._must_forget:
            self._forget()
        if depth is None or self._settings.projector == "no" or not self._is_due(frames):
            return self._fault
        if has_fault(findings, CAMERA_POSE, "", self._rig.core) or has_fault(
            findings, CAMERA_POSE_UNCHECKED, ""
        ):
            return self._fault
        if sampled is None:
            self._expected_ns = self._last_ns
            sampled = self._sampler.sample(self._grid.view(frames, depth), self._learned)
        if sampled.shift is None:
            if self._settings.learning and not any(one.is_fault for one in findings):
                self._learn(sampled.textures, sampled.is_bare, sampled.height_mm)
            return ()
        return self._assess(sampled.shift)

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

    def _learn(self, now: Mapping[str, Texture], is_bare: NDArray[np.bool_], height_mm: float) -> None:
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
