"""Matching of several cameras' images to common trigger instants, with their exposure times and the belt's position.

Exposure times follow from the instants at which the cameras took new ones, the position from the core camera's
encoder counter.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Generic, Literal, TypeVar

import numpy as np

from beltscape.sources.genicam.clock import CameraClock
from beltscape.sources.genicam.settings import CameraEncoderSettings

Payload = TypeVar("Payload")


@dataclass(frozen=True, slots=True)
class CameraImage(Generic[Payload]):
    """One image of one camera as received."""

    camera: str
    frame_id: int
    """The camera's count: 1 to 65535 and again from 1, or 64 bits; it begins anew when the camera is opened."""
    camera_ns: int
    """Camera's own clock at the exposure."""
    arrival_ns: int
    """Host's monotonic clock at its first packet."""
    payload: Payload


@dataclass(frozen=True, slots=True)
class MatchedInstant(Generic[Payload]):
    """The images of one instant."""

    time_ns: int
    """Host's monotonic clock at the instant; increasing."""
    shots: dict[str, CameraImage[Payload]]
    """By camera; cameras without an image are absent."""


@dataclass(frozen=True, slots=True)
class MatchingRules:
    """Rules by which images are matched."""

    window_ns: int
    """Images this near to the first of an instant may belong to it; less than half the time between instants."""
    skew_ns: int
    """Images farther from the median one are skipped."""
    timeout_ns: int
    """An instant waits this long for its last image."""
    clocks: Literal["own", "ptp"] = "own"
    """ptp: the cameras share one clock."""
    common_pulse: bool = False
    """Whether one pulse on a wire triggers all: a constant difference of two clocks is then their error, not skew."""
    start_ns: int = 0
    """Time for which the first camera waits for the others at the start."""


@dataclass(slots=True)
class CameraStatistics:
    """Statistics of one camera's images."""

    taken: int = 0
    """Complete images, without duplicates."""
    missed: int = 0
    """Instants that were completed without it."""
    late: int = 0
    """Images that arrived after their instant was completed."""
    duplicates: int = 0
    """Images that arrived again."""
    skipped: int = 0
    """Images that are missing by its count."""
    skewed: int = 0
    """Images skipped because they were too far from the others."""
    skew_ns: int | None = None
    """Time from the core's image to this camera's last one; negative if before it."""
    out_of_skew: int = 0
    """Number of its latest images in a row that were skipped for that."""
    unsynchronised: bool = False
    """Whether its clock differs from the shared one."""
    silent: bool = False
    """Whether an instant timed out waiting for it and no image has arrived since."""
    has_clock: bool = False
    """Whether its clock has been estimated since it was opened."""


KEPT_IDS = 64
"""Number of a camera's latest images among which duplicates are detected: more than are in flight."""
BIAS_OF = 51
"""Number of instants from which the constant part of a clock's error is estimated, by their median; chosen."""
BIAS_FROM = 5
"""Number of instants from which it is used: a median of five withstands two outliers."""
UNSYNCHRONISED_NS = 50_000_000
"""Clocks that differ by more than this are not shared: IEEE 1588 keeps microseconds, NTP milliseconds."""
LAST_ID = 65_535
"""Last count of GigE Vision's 16-bit block identifiers, after which 1 follows (0 is reserved)."""
MOST_MISSING = 1000
"""Largest step of the count that is missing images; a larger one is a restarted count. Chosen."""


@dataclass(slots=True)
class _Camera:
    clock: CameraClock
    statistics: CameraStatistics = field(default_factory=CameraStatistics)
    ids: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=KEPT_IDS))
    newest_ns: int | None = None
    """Host time of its newest image."""
    offsets_ns: deque[int] = field(default_factory=lambda: deque(maxlen=BIAS_OF))
    """Offsets of its last images from the core's, by the estimated clocks."""

    @property
    def bias_ns(self) -> int:
        return round(float(np.median(self.offsets_ns))) if len(self.offsets_ns) >= BIAS_FROM else 0


@dataclass(slots=True)
class _Instant(Generic[Payload]):
    at_ns: int
    opened_ns: int
    shots: dict[str, tuple[int, CameraImage[Payload]]]
    """By camera: host time of the image, and the image."""


class InstantMatcher(Generic[Payload]):
    """Collects images into instants; an instant is returned when it is complete or its timeout has passed.

    Every image's time is converted to the host's clock by its camera's clock, so delays on the network do not matter.
    Instants are at least twice ``window_ns`` apart; with clock errors below half of it, no image is assigned to a
    wrong instant.
    """

    def __init__(self, cameras: Sequence[str], core: str, rules: MatchingRules) -> None:
        self._rules = rules
        self._core = core
        self._cameras = {name: _Camera(self._new_clock()) for name in cameras}
        self._open: list[_Instant[Payload]] = []
        self._first_ns: int | None = None
        self._start_ns: int | None = None
        self._last_instant_ns: int | None = None
        self._last_time_ns: int | None = None

    def _new_clock(self) -> CameraClock:
        # with PTP one clock serves all cameras, and its error is the same for each
        return CameraClock(self._rules.window_ns // 4, *([0.0] if self._rules.clocks == "ptp" else []))

    def statistics(self, camera: str) -> CameraStatistics:
        """Return the statistics of a camera's images."""
        return self._cameras[camera].statistics

    def clock(self, camera: str) -> CameraClock:
        """Return a camera's estimated clock."""
        return self._cameras[camera].clock

    def on_reopened(self, camera: str) -> None:
        """Handle that the camera was opened (again): its count and its clock may begin anew."""
        one = self._cameras[camera]
        one.clock = self._new_clock()
        one.ids.clear()
        one.offsets_ns.clear()
        one.statistics.has_clock = False

    def add(self, shot: CameraImage[Payload], now_ns: int) -> None:
        """Add an image."""
        one = self._cameras[shot.camera]
        if (shot.frame_id, shot.camera_ns) in one.ids:
            one.statistics.duplicates += 1
            return
        if one.ids:
            one.statistics.skipped += count_missing(one.ids[-1][0], shot.frame_id)
        one.ids.append((shot.frame_id, shot.camera_ns))
        one.statistics.taken += 1
        is_valid = one.clock.add(shot.camera_ns, shot.arrival_ns)
        one.statistics.has_clock = one.clock.is_settled
        if not one.clock.is_settled:
            one.offsets_ns.clear()
        host_ns = self._host_ns(one, shot.camera_ns) if is_valid else None
        if host_ns is None or not self._has_started(host_ns, now_ns):
            return
        one.statistics.silent = False
        one.newest_ns = host_ns if one.newest_ns is None else max(one.newest_ns, host_ns)
        self._assign(shot, host_ns, now_ns)

    def _has_started(self, host_ns: int, now_ns: int) -> bool:
        """Return whether an image is after the start, when all cameras deliver or have had the time to."""
        if self._start_ns is None:
            self._first_ns = now_ns if self._first_ns is None else self._first_ns
            if now_ns - self._first_ns < self._rules.start_ns and not all(
                one.statistics.has_clock for one in self._cameras.values()
            ):
                return False
            # between two instants: else the first one would lack the images that came before this one
            window = self._rules.window_ns
            self._start_ns = now_ns + window if self._rules.start_ns else host_ns - window
        return host_ns >= self._start_ns

    def _host_ns(self, one: _Camera, camera_ns: int) -> int | None:
        """Return the host time of an image; None if the clocks should be shared and this one is not."""
        own = one.clock.host_ns(camera_ns)
        if self._rules.clocks == "own":
            return own - one.bias_ns
        settled = [self._cameras[self._core], *self._cameras.values()]
        common = next(c.clock for c in settled if c.clock.is_settled).host_ns(camera_ns)
        one.statistics.unsynchronised = abs(common - own) > UNSYNCHRONISED_NS
        return None if one.statistics.unsynchronised else common

    def _assign(self, shot: CameraImage[Payload], host_ns: int, now_ns: int) -> None:
        window = self._rules.window_ns
        if self._last_instant_ns is not None and host_ns < self._last_instant_ns + window:
            self._cameras[shot.camera].statistics.late += 1
            return
        near = [instant for instant in self._open if abs(instant.at_ns - host_ns) < window]
        nearest: _Instant[Payload] | None = min(
            near, key=lambda instant: abs(instant.at_ns - host_ns), default=None
        )
        if nearest is None or shot.camera in nearest.shots:
            nearest = _Instant(host_ns, now_ns, {})
            self._open.append(nearest)
            self._open.sort(key=lambda instant: instant.at_ns)
        nearest.shots[shot.camera] = host_ns, shot

    def pop_due(self, now_ns: int) -> list[MatchedInstant[Payload]]:
        """Remove and return the instants that are complete or have timed out, in order."""
        out: list[MatchedInstant[Payload]] = []
        while self._open and self._is_due(self._open[0], now_ns):
            out.append(self._complete(self._open.pop(0)))
        return out

    def deadline_ns(self) -> int | None:
        """Return when to call ``pop_due`` again if no image arrives; None: no instant waits."""
        return self._open[0].opened_ns + self._rules.timeout_ns if self._open else None

    def _is_due(self, instant: _Instant[Payload], now_ns: int) -> bool:
        awaited = [
            one
            for name, one in self._cameras.items()
            if name not in instant.shots and self._is_awaited(one, instant)
        ]
        if awaited and now_ns < instant.opened_ns + self._rules.timeout_ns:
            return False
        for one in awaited:
            one.statistics.silent = True
        return True

    def _is_awaited(self, one: _Camera, instant: _Instant[Payload]) -> bool:
        if not one.statistics.has_clock or one.statistics.silent:
            return False
        # images of one camera arrive in order: a newer one shows that this one is lost
        return one.newest_ns is None or one.newest_ns < instant.at_ns + self._rules.window_ns

    def _complete(self, instant: _Instant[Payload]) -> MatchedInstant[Payload]:
        self._last_instant_ns = instant.at_ns
        for name, one in self._cameras.items():
            one.statistics.missed += name not in instant.shots
        selected = self._select_within_skew(instant)
        times = sorted(time for name, (time, _) in instant.shots.items() if name in selected)
        time_ns = instant.shots[self._core][0] if self._core in selected else times[(len(times) - 1) // 2]
        if self._last_time_ns is not None:
            time_ns = max(time_ns, self._last_time_ns + 1)
        self._last_time_ns = time_ns
        return MatchedInstant(
            time_ns, {name: shot for name, (_, shot) in instant.shots.items() if name in selected}
        )

    def _select_within_skew(self, instant: _Instant[Payload]) -> set[str]:
        """Return the cameras within the allowed skew of the median image; of two images, of the core's."""
        times = {name: time for name, (time, _) in instant.shots.items()}
        ordered = sorted(times.values())
        middle = ordered[(len(ordered) - 1) // 2]
        if len(ordered) == 2 and self._core in times:
            middle = times[self._core]
        selected = {name for name, time in times.items() if abs(time - middle) <= self._rules.skew_ns}
        core_ns = times.get(self._core)
        for name, time in times.items():
            one = self._cameras[name]
            one.statistics.out_of_skew = 0 if name in selected else one.statistics.out_of_skew + 1
            one.statistics.skewed += name not in selected
            one.statistics.skew_ns = None if core_ns is None else time - core_ns
            if core_ns is not None and self._rules.common_pulse and self._rules.clocks == "own":
                one.offsets_ns.append(time - core_ns + one.bias_ns)
        return selected


def count_missing(before: int, after: int) -> int:
    """Return the number of images missing between two of a camera's counts; 0 if the count began anew."""
    step = after - before
    if step < 0 and before <= LAST_ID:
        step += LAST_ID
    return step - 1 if 1 <= step <= MOST_MISSING else 0


@dataclass(frozen=True, slots=True)
class _Change:
    before_us: float
    present_us: float
    from_ns: int
    """Images that arrived before have the exposure time before."""
    until_ns: int
    """Images that arrive from here on have the present one."""


class ExposureTimes:
    """The exposure times of the cameras by the arrival of their images; the caller locks."""

    def __init__(self, exposures_us: Mapping[str, float], period_ns: int, *, is_triggered: bool) -> None:
        """``is_triggered``: new exposure times are set between two software triggers, ``period_ns`` apart."""
        self._period_ns, self._is_triggered = period_ns, is_triggered
        self._changes = {name: _Change(us, us, 0, 0) for name, us in exposures_us.items()}

    def set_present(self, camera: str, exposure_us: float, at_ns: int) -> None:
        """Account for a new exposure time that the camera took at an instant of the monotonic clock."""
        before = self._changes[camera].present_us
        first_ns = at_ns + round(500 * exposure_us) if self._is_triggered else at_ns
        settling_ns = (
            0 if self._is_triggered else 2 * self._period_ns + round(1000 * max(before, exposure_us))
        )
        self._changes[camera] = _Change(before, exposure_us, first_ns, first_ns + settling_ns)

    def find(self, camera: str, arrival_ns: int) -> float:
        """Return the exposure time of an image in µs; NaN while the camera may have used either."""
        change = self._changes[camera]
        if arrival_ns < change.from_ns:
            return change.before_us
        return change.present_us if arrival_ns >= change.until_ns else float("nan")


class BeltCounter:
    """Unwraps the counts of a counter of limited width to a continuous position.

    The first position is the count itself: a camera that stays powered continues where it was when the program
    stopped, unless its counter has wrapped meanwhile.
    """

    def __init__(self, settings: CameraEncoderSettings) -> None:
        self._mm = settings.mm_per_count
        self._range = 1 << settings.bits
        self._last: int | None = None
        self._counts = 0
        self._reopened = False

    def on_reopened(self) -> None:
        """Handle that the camera was opened again: it may have lost power, and its count with it."""
        self._reopened = True

    def position_mm(self, count: int) -> float:
        """Return the belt's position at the next image's count; the belt may also roll back a little."""
        count %= self._range
        if self._last is None:
            self._counts = count
        else:
            self._counts += self._step(count)
        self._last = count
        self._reopened = False
        return self._counts * self._mm

    def _step(self, count: int) -> int:
        assert self._last is not None
        forward = (count - self._last) % self._range
        if self._reopened and count < self._last and self._mm > 0:
            return count  # the counter restarted at 0; travel without power is unknown
        return forward - self._range if forward >= self._range // 2 else forward
