"""A recorded capture as if its cameras were running now."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from time import monotonic, monotonic_ns

from beltscape.core.frames import FrameSet
from beltscape.core.live import CameraHealth, CameraState
from beltscape.sources.folder import FolderSource

_RATE_S = 5.0


@dataclass(frozen=True, slots=True)
class FrameTime:
    """When a frame of the capture was taken, and where the belt was."""

    frame: str
    time_ns: int
    position_mm: float | None
    """None without an encoder."""


class ReplaySource:
    """Gives the frames of a capture at the pace of their times, or as fast as they are taken.

    Frame, time and position are the capture's own. In a ``loop`` the belt goes on from round to round, by the mean
    step from the last frame to the first.
    """

    def __init__(
        self,
        folder: FolderSource,
        frame_times: Sequence[FrameTime],
        *,
        paced: bool = True,
        loop: bool = False,
    ) -> None:
        """``frame_times`` in the order of time; one without images gives a frame set without images."""
        self._folder, self._cues, self._paced, self._loop = folder, tuple(frame_times), paced, loop
        self._closed = threading.Event()
        self._taken: dict[str, int] = dict.fromkeys(folder.cameras, 0)
        self._missed: dict[str, int] = dict.fromkeys(folder.cameras, 0)
        self._given: list[float] = []

    @property
    def cameras(self) -> tuple[str, ...]:
        """The capture's, as far as the rig has them."""
        return self._folder.cameras

    def __iter__(self) -> Iterator[FrameSet]:
        start, first = monotonic_ns(), self._cues[0].time_ns
        rounds = 0
        while not self._closed.is_set():
            for frame_time in self._cues:
                shifted = self._shifted(frame_time, rounds)
                if self._paced and self._closed.wait(
                    max(0, start + shifted.time_ns - first - monotonic_ns()) * 1e-9
                ):
                    return
                if self._closed.is_set():
                    return
                yield self._frames(frame_time, shifted)
            rounds += 1
            if not self._loop:
                return

    def health(self) -> Mapping[str, CameraHealth]:
        """All that can be said of a recording: what images there are."""
        now = monotonic()
        rate = sum(now - given < _RATE_S for given in self._given) / _RATE_S
        return {name: self._health(name, rate) for name in self.cameras}

    def close(self) -> None:
        """Stop before the next frame."""
        self._closed.set()

    def _health(self, name: str, rate_hz: float) -> CameraHealth:
        taken, missed = self._taken[name], self._missed[name]
        state: CameraState = "ok" if taken else "lost" if missed else "waiting"
        message = f"{name}: no image in the capture so far" if state == "lost" else ""
        return CameraHealth(name, state, taken, missed, rate_hz if taken else 0.0, float("nan"), message)

    def _shifted(self, frame_time: FrameTime, rounds: int) -> FrameTime:
        if not rounds:
            return frame_time
        first, last, steps = self._cues[0], self._cues[-1], max(len(self._cues) - 1, 1)
        around = rounds * (steps + 1) / steps
        time = frame_time.time_ns + round(around * (last.time_ns - first.time_ns))
        position = frame_time.position_mm
        if position is not None and first.position_mm is not None and last.position_mm is not None:
            position += around * (last.position_mm - first.position_mm)
        return FrameTime(f"{frame_time.frame}-{rounds}", time, position)

    def _frames(self, frame_time: FrameTime, shifted: FrameTime) -> FrameSet:
        images = self._folder.images(frame_time.frame)
        for name in self.cameras:
            counts = self._taken if name in images else self._missed
            counts[name] += 1
        now = monotonic()
        self._given = [given for given in self._given if now - given < _RATE_S] + [now]
        return FrameSet(shifted.frame, images, shifted.time_ns, shifted.position_mm)
