"""The check of the cameras' synchronisation over the frames of a moving belt."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from beltscape.core.alarm_catalogue import CAMERA_POSE, CAMERA_POSE_UNCHECKED
from beltscape.core.depth import DepthMap
from beltscape.core.findings import Finding, has_fault
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.health.images.surface_samples import (
    Displacement,
    SurfaceGrid,
    SurfaceSamples,
    correlate_at_rest,
    measure_displacement,
)
from beltscape.health.images.synchronisation import (
    CameraDelay,
    CheckPool,
    PairCheck,
    check_synchronisation,
    compute_core_delay,
    compute_depth_error,
    find_late_core,
    make_unmeasured_finding,
    pool_delays,
    separate_delay,
)
from beltscape.health.settings import HealthSettings
from beltscape.workers.calls import CallMaker, CallsHere, PendingCall
from beltscape.workers.transport import SharedObject

_EVERY = 8
"""Number of frames per check; a check takes about a tenth of a second. A suspicious one is repeated at once."""
_PERIOD_NS = 900_000_000
"""Least time between two checks: six of them, which show a delay of 1 ms, then take less than 10 s at any frame rate.
A little less than 8 frames at 8 Hz, the rate of the bench of faults."""
_NEAREST, _FARTHEST = 0.05, 0.35
"""Travel between the two frames over the distance of the belt: nearer, the projected pattern overlaps; farther, the
cameras see other sides of the stones."""
_LEAST_CORRELATION = 0.15
"""Correlation of moving texture that is surely not chance; bare rubber has 0.03, heaps of stones 0.2 to 0.45."""
_NOISE = 0.012
"""σ of a displacement, mm, times the square of the correlation: in three sound captures of 612 × 512 px."""
_BIAS = 1.8e-4
"""σ of the displacement that remains in the mean over frames, over the distance; up to 2.4e-4 in three rigs."""
_NOISE_PIXEL_MM = 1.28
"""Size of a pixel on the belt at which `_NOISE` holds; with twice the size it scatters by 0.17 mm instead of 0.07."""
_MEMORY = 3
"""Checks whose median is taken, so that a single one accuses no camera."""
_CONFIRMING = 2
"""Number of checks from which on a camera is accused."""
_CLEARED = 0.5
"""A fault ends at a check that shows less than this share of its delay."""
_SPEEDS = 40
"""Number of checks that are kept to separate a delay from a moved camera by the speed."""
_STATIC = 0.5
"""Share of the moving texture's displacement that the same instant must not show: else the camera may have moved."""
_OLD = 0.5
"""Correlation at rest with the frame before from which an image is that frame's; its own frame's is less then."""


@dataclass(frozen=True, slots=True, eq=False)
class ComparedPair:
    """What two frames show of the auxiliaries' instants."""

    moved: Mapping[str, Displacement]
    old: frozenset[str]
    """Auxiliaries whose image is that of the frame before."""


@lru_cache(maxsize=2)
def _make_grid(rig: SharedObject[Rig]) -> SurfaceGrid:
    return SurfaceGrid(rig.value)


@dataclass(frozen=True, slots=True, eq=False)
class FramePair:
    """Two frames to compare."""

    rig: SharedObject[Rig]
    before: SurfaceSamples
    now: SurfaceSamples
    travel_mm: NDArray[np.float64]
    """(3,) the belt's motion between them in the core's frame."""
    names: tuple[str, ...]
    """The auxiliaries that both have."""
    is_next: bool
    """Whether one follows on the other, so that an image may be that of the frame before."""


def compare_pair(pair: FramePair) -> ComparedPair:
    """Compare the auxiliaries with the core in two frames."""
    grid, core, before, now = _make_grid(pair.rig), pair.rig.value.core, pair.before, pair.now
    moved = measure_displacement(grid, before, now, pair.travel_mm, core, pair.names)
    old = (name for name in pair.names if pair.is_next and _is_old(grid, core, name, before, now))
    return ComparedPair(moved, frozenset(old))


def _is_old(grid: SurfaceGrid, core: str, name: str, before: SurfaceSamples, now: SurfaceSamples) -> bool:
    """Return whether a camera's image is that of the frame before."""
    own = correlate_at_rest(now.own[core], now.own[name], now.surface.is_smooth)
    least = max(_OLD, own + 0.1)
    if least >= 1:  # no correlation exceeds it
        return False
    old = grid.sample(now.textures[name], name, before.surface.points_mm)
    return correlate_at_rest(before.own[core], old, before.surface.is_smooth) > least


@dataclass(frozen=True, slots=True, eq=False)
class _Stored:
    """A frame that waits for the next one."""

    number: int
    frame: SurfaceSamples
    cameras: tuple[str, ...]
    position_mm: float
    time_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class _Comparison:
    """Two frames that are being compared."""

    before: _Stored
    now: _Stored
    along: NDArray[np.float64]
    distance_mm: float
    names: tuple[str, ...]
    pair: PendingCall[ComparedPair] | None
    """None: there is no camera to compare."""
    is_doubtful: bool
    """Whether the core may have moved, so that no auxiliary is accused anew."""


class SynchronisationMonitor:
    """Compares what the cameras show of the moving material in pairs of frames."""

    def __init__(
        self,
        rig: Rig,
        settings: HealthSettings,
        grid: SurfaceGrid | None = None,
        calls: CallMaker | None = None,
    ) -> None:
        """``grid`` is one that other checks of the same frames use, too; ``calls`` compares, None: `begin` does."""
        self._rig, self._settings = rig, settings
        self._grid, self._calls = grid or SurfaceGrid(rig), calls or CallsHere()
        self._shared_rig = SharedObject(rig)
        self._number = 0
        self._due = 0
        self._compared_ns: int | None = None
        """Time of the last comparison."""
        self._before: _Stored | None = None
        self._recent: dict[str, deque[CameraDelay]] = defaultdict(lambda: deque(maxlen=_MEMORY))
        self._history: dict[str, deque[CameraDelay]] = defaultdict(lambda: deque(maxlen=_SPEEDS))
        self._pool = CheckPool()
        self._faults: tuple[Finding, ...] = ()
        self._comparison: _Comparison | None = None
        """What was begun and is not completed."""

    def expects(self, frames: FrameSet, ahead: int) -> bool:
        """Return whether a frame after ``ahead`` others will probably be compared: two that are due will be."""
        if frames.time_ns is None or self._is_soon(frames.time_ns):
            return False
        number, soonest = self._number + 1 + ahead, self._number + 1
        if self._before is not None:
            return number == soonest
        return 0 <= number - max(self._due, soonest) <= 1

    def _is_soon(self, time_ns: int) -> bool:
        """Return whether a frame follows the last comparison too soon for another one."""
        return self._compared_ns is not None and abs(time_ns - self._compared_ns) < _PERIOD_NS

    def check(
        self,
        frames: FrameSet,
        depth: DepthMap | None,
        position_mm: float | None,
        along: NDArray[np.float64] | None,
        others: Sequence[Finding] = (),
    ) -> tuple[Finding, ...]:
        """Return the findings of the next frame; see `begin` and `complete`."""
        self.begin(frames, depth, position_mm, along, others)
        return self.complete()

    def begin(
        self,
        frames: FrameSet,
        depth: DepthMap | None,
        position_mm: float | None,
        along: NDArray[np.float64] | None,
        others: Sequence[Finding] = (),
    ) -> None:
        """Begin to check the next frame, after the one before has been completed.

        ``position_mm`` is the belt's travel at the frame, ``along`` (3,) its direction in the core's frame.
        ``others`` are the findings about the frame's cameras: all auxiliaries disagree with a core that moved, or may
        have while it is not known which camera did, so that none of them is accused anew.
        """
        self._number += 1
        if depth is None or position_mm is None or along is None or frames.time_ns is None:
            return
        before = self._before
        if before is None:
            if self._number >= self._due and not self._is_soon(frames.time_ns):
                self._before = self._store(frames, depth, position_mm, frames.time_ns)
            return
        travel, distance = position_mm - before.position_mm, float(np.nanmedian(depth.depth_mm[::8, ::8]))
        if not travel >= _NEAREST * distance:
            return
        now = self._store(frames, depth, position_mm, frames.time_ns)
        if travel > _FARTHEST * distance or frames.time_ns <= before.time_ns:
            self._before = now
            return
        is_doubtful = has_fault(others, CAMERA_POSE, "", self._rig.core)
        is_doubtful |= has_fault(others, CAMERA_POSE_UNCHECKED, "")
        self._comparison = self._begin_comparison(before, now, along, distance, is_doubtful=is_doubtful)
        self._due, self._compared_ns, self._before = self._number + _EVERY, frames.time_ns, None

    def complete(self) -> tuple[Finding, ...]:
        """Return the findings "camera_sync" of the frame that was begun; between two checks those that are faults."""
        comparison, self._comparison = self._comparison, None
        if comparison is None:
            return self._faults
        findings = self._assess(comparison)
        if comparison.is_doubtful:
            findings = [self._acquit(finding) for finding in findings]
        self._faults = tuple(finding for finding in findings if finding.is_fault)
        is_suspect = any(one and one[-1].exceeds(self._settings.skew_ms) for one in self._recent.values())
        self._before = comparison.now if is_suspect and not self._faults else None
        return tuple(findings)

    def _acquit(self, finding: Finding) -> Finding:
        """Return the finding without an auxiliary's fault that began in this check."""
        is_old = any(one.subject == finding.subject for one in self._faults)
        if is_old or not finding.is_fault or finding.subject == self._rig.core:
            return finding
        return make_unmeasured_finding(finding.subject, self._settings)

    def _store(self, frames: FrameSet, depth: DepthMap, position_mm: float, time_ns: int) -> _Stored:
        stored = self._grid.view(frames, depth).sample_surface(self._rig.cameras)
        return _Stored(self._number, stored, tuple(stored.textures), position_mm, time_ns)

    def _begin_comparison(
        self,
        before: _Stored,
        now: _Stored,
        along: NDArray[np.float64],
        distance_mm: float,
        *,
        is_doubtful: bool,
    ) -> _Comparison:
        """Begin to compare two frames."""
        core = self._rig.core
        names = tuple(name for name in now.cameras if name in before.cameras and name != core)
        if core not in now.cameras or core not in before.cameras or not names:
            return _Comparison(before, now, along, distance_mm, (), None, is_doubtful)
        travel_mm = along * (now.position_mm - before.position_mm)
        is_next = now.number == before.number + 1
        pair = FramePair(self._shared_rig, before.frame, now.frame, travel_mm, names, is_next)
        pending = self._calls.begin(compare_pair, pair)
        return _Comparison(before, now, along, distance_mm, names, pending, is_doubtful)

    def _assess(self, comparison: _Comparison) -> list[Finding]:
        """Return the findings about the core and the auxiliaries that were compared."""
        if comparison.pair is None:
            return []
        core, names, found = self._rig.core, comparison.names, comparison.pair.result()
        before, now, moved = comparison.before, comparison.now, found.moved
        along, distance_mm = comparison.along, comparison.distance_mm
        travel = now.position_mm - before.position_mm
        seconds = (now.time_ns - before.time_ns) * 1e-9
        delays = {name: self._estimate(name, moved[name], travel / seconds, distance_mm) for name in names}
        for name in found.old:
            delays[name] = CameraDelay(-travel, _BIAS * distance_mm, travel / seconds)
        measured = {name: one for name, one in delays.items() if one is not None}
        late_core = find_late_core(measured, self._settings.skew_ms)
        if late_core is not None:
            measured = {core: late_core}
        elif len(measured) > 1 and not (nearest := compute_core_delay(measured)).exceeds(
            self._settings.skew_ms
        ):
            measured[core] = nearest
        pooled = self._pool_checks(moved, now.position_mm, along, travel / seconds, distance_mm)
        if late_core is None:  # a single check that is open, or accuses, outweighs those before it
            measured |= {
                name: pooled[name]
                for name, one in measured.items()
                if name in pooled and not one.exceeds(self._settings.skew_ms)
            }
        return [self._make_finding(name, measured.get(name), along, distance_mm) for name in (core, *names)]

    def _pool_checks(
        self,
        moved: Mapping[str, Displacement],
        position_mm: float,
        along: NDArray[np.float64],
        speed_mm_s: float,
        distance_mm: float,
    ) -> dict[str, CameraDelay]:
        """Return the delays by the last checks and this one."""
        seen = {name: one for name, one in moved.items() if one.correlation >= _LEAST_CORRELATION}
        check = PairCheck(
            {name: one.moving_mm for name, one in seen.items()},
            {name: one.same_mm for name, one in seen.items()},
            {name: self._compute_noise(one, distance_mm) for name, one in seen.items()},
            speed_mm_s,
            distance_mm,
        )
        baselines = {name: float(self._rig.cam_from_core[name].center_mm @ along) for name in moved}
        return pool_delays(self._pool.add(check, position_mm), self._rig.core, baselines)

    def _compute_noise(self, moved: Displacement, distance_mm: float) -> float:
        """Return one standard deviation, mm, of a displacement that differs between checks."""
        pixel_mm = distance_mm / float(self._rig.core_camera.focal_px.mean())
        return _NOISE / moved.correlation**2 * pixel_mm / _NOISE_PIXEL_MM

    def _estimate(
        self, name: str, moved: Displacement, speed_mm_s: float, distance_mm: float
    ) -> CameraDelay | None:
        """Return a camera's delay by the last checks; None where they leave it open."""
        if moved.correlation < _LEAST_CORRELATION:
            return None
        noise = self._compute_noise(moved, distance_mm)
        newest = CameraDelay(moved.moving_mm, float(np.hypot(noise, _BIAS * distance_mm)), speed_mm_s)
        self._history[name].append(newest)
        if newest.exceeds(self._settings.skew_ms) and abs(moved.same_mm) > _STATIC * abs(moved.moving_mm):
            delay_ms, sigma_ms = separate_delay(self._history[name])
            if not np.isfinite(sigma_ms):
                return None
            newest = CameraDelay(1e-3 * delay_ms * speed_mm_s, 1e-3 * sigma_ms * speed_mm_s, speed_mm_s)
        recent = self._recent[name]
        recent.append(newest)
        middle = 1e-3 * float(np.median([one.delay_ms for one in recent])) * speed_mm_s
        delay = CameraDelay(middle, newest.sigma_mm, speed_mm_s)
        limit = self._settings.skew_ms
        if not newest.exceeds(limit):
            return delay
        # an unusual check that is not confirmed yet neither passes nor accuses
        return newest if len(recent) >= _CONFIRMING and delay.exceeds(limit) else None

    def _make_finding(
        self, name: str, delay: CameraDelay | None, along: NDArray[np.float64], distance_mm: float
    ) -> Finding:
        """Return a camera's finding; a fault holds until a check shows less than half of its delay."""
        fault = next((one for one in self._faults if one.subject == name), None)
        if delay is None:
            return fault or make_unmeasured_finding(name, self._settings)
        error = compute_depth_error(name, delay.displacement_mm, along, distance_mm, self._rig)
        finding = check_synchronisation(name, delay, error, self._settings)
        holds = fault is not None and abs(finding.value) > _CLEARED * abs(fault.value)
        return fault if fault is not None and holds and not finding.is_fault else finding
