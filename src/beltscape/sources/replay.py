"""Live source that replays a recorded capture, at its own pace or as fast as possible."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from time import monotonic, monotonic_ns

from beltscape.core.events import CameraHealth, CameraState
from beltscape.core.frames import FrameSet, Image
from beltscape.core.translatable_message import make_message
from beltscape.sources.folder import FolderSource

_RATE_S = 5.0
"""Interval over which the rate of frames is counted, as for live cameras (`genicam.health`)."""


@dataclass(frozen=True, slots=True)
class FrameTime:
    """Time and belt position of a frame of the capture."""

    frame: str
    time_ns: int
    position_mm: float | None
    """None without an encoder."""


class ReplaySource:
    """Yields the frames of a capture at the pace of their times, or as fast as they are consumed.

    Frame, time and position are the capture's own. In a ``loop`` the belt advances from round to round, by the mean
    step from the last frame to the first.
    """

    def __init__(
        self,
        folder: FolderSource,
        frame_times: Sequence[FrameTime],
        *,
        paced: bool = True,
        loop: bool = False,
        reads_ahead: bool = False,
    ) -> None:
        """``frame_times`` in the order of time; a frame without images gives a frame set without images.

        ``reads_ahead``: another process reads the images before their time.
        """
        self._reads_ahead = reads_ahead
        self._folder, self._frame_times, self._paced, self._loop = folder, tuple(frame_times), paced, loop
        self._closed = threading.Event()
        self._taken: dict[str, int] = dict.fromkeys(folder.cameras, 0)
        self._missed: dict[str, int] = dict.fromkeys(folder.cameras, 0)
        self._yield_times_s: list[float] = []

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the capture's cameras that the rig has."""
        return self._folder.cameras

    def __iter__(self) -> Iterator[FrameSet]:
        start, first = monotonic_ns(), self._frame_times[0].time_ns
        names = (frame_time.frame for frame_time, _ in self._list_rounds())
        images = self._folder.read_ahead(names) if self._reads_ahead else map(self._folder.images, names)
        for (frame_time, rounds), read in zip(self._list_rounds(), images, strict=False):
            replayed = self._shift_to_round(frame_time, rounds)
            if self._paced and self._closed.wait(
                max(0, start + replayed.time_ns - first - monotonic_ns()) * 1e-9
            ):
                return
            if self._closed.is_set():
                return
            yield self._frames(frame_time, replayed, read)

    def _list_rounds(self) -> Iterator[tuple[FrameTime, int]]:
        """Yield the frames with the number of their round."""
        for rounds in count() if self._loop else (0,):
            for frame_time in self._frame_times:
                yield frame_time, rounds

    def health(self) -> Mapping[str, CameraHealth]:
        """Return the state of every camera, by the images that the recording has."""
        now = monotonic()
        rate = sum(now - time_s < _RATE_S for time_s in self._yield_times_s) / _RATE_S
        return {name: self._health(name, rate) for name in self.cameras}

    def close(self) -> None:
        """Stop before the next frame."""
        self._closed.set()

    def _health(self, name: str, rate_hz: float) -> CameraHealth:
        taken, missed = self._taken[name], self._missed[name]
        state: CameraState = "ok" if taken else "lost" if missed else "waiting"
        message = make_message("not_in_capture", subject=name) if state == "lost" else ""
        return CameraHealth(name, state, taken, missed, rate_hz if taken else 0.0, float("nan"), message)

    def _shift_to_round(self, frame_time: FrameTime, rounds: int) -> FrameTime:
        if not rounds:
            return frame_time
        first, last, steps = self._frame_times[0], self._frame_times[-1], max(len(self._frame_times) - 1, 1)
        factor = rounds * (steps + 1) / steps
        time = frame_time.time_ns + round(factor * (last.time_ns - first.time_ns))
        position = frame_time.position_mm
        if position is not None and first.position_mm is not None and last.position_mm is not None:
            position += factor * (last.position_mm - first.position_mm)
        return FrameTime(f"{frame_time.frame}-{rounds}", time, position)

    def _frames(self, frame_time: FrameTime, replayed: FrameTime, images: Mapping[str, Image]) -> FrameSet:
        for name in self.cameras:
            counts = self._taken if name in images else self._missed
            counts[name] += 1
        now = monotonic()
        self._yield_times_s = [time_s for time_s in self._yield_times_s if now - time_s < _RATE_S] + [now]
        exposures_us = self._folder.exposures_us(frame_time.frame)
        return FrameSet(
            replayed.frame, images, replayed.time_ns, replayed.position_mm, exposures_us, frame_time.frame
        )
