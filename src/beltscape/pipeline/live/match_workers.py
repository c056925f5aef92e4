"""The worker processes of a run: they match its frame sets side by side, and results come in the frames' order.

Their number changes no result: a match takes nothing but the frame's images.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from beltscape.core.frames import FrameSet
from beltscape.core.progress import Reporter
from beltscape.core.system_calls import count_usable_cores
from beltscape.pipeline.reconstructing.checked_matcher import MonitoredMatcher, PendingFrame
from beltscape.pipeline.reconstructing.match_ahead import MatcherFactory, MatchWorkers, match_frame
from beltscape.workers.processes import ProcessPool

Submit = Callable[[FrameSet], PendingFrame]
"""Checks the images of a frame set and begins to match it."""


def count_workers(setting: int | Literal["auto"]) -> int:
    """Return the number of worker processes for the setting: one for each core, and none where there is one only."""
    if setting != "auto":
        return setting
    cores = count_usable_cores()
    return cores if cores > 1 else 0


def _ignore(line: str) -> None:
    del line


@dataclass(slots=True, eq=False)
class LiveWorkers:
    """The processes, which live as long as the run; contexts of measurement that follow each other share them."""

    count: int
    """Number of processes."""
    on_death: Callable[[str], object] = _ignore
    """Receives a line on a process that died and was replaced."""
    on_end: Callable[[], object] = lambda: None
    """Called whenever a match has ended."""
    _pool: ProcessPool = field(init=False)

    def __post_init__(self) -> None:
        self._pool = ProcessPool(
            match_frame, None, self.count, on_death=self._tell_death, on_end=self._tell_end
        )

    def _tell_death(self, line: str) -> None:
        self.on_death(line)

    def _tell_end(self) -> None:
        self.on_end()

    @property
    def ahead(self) -> int:
        """Return the number of frame sets to submit at most: one for each process, and one that waits."""
        return self.count + 1

    def list_processes(self) -> list[int]:
        """Return the identities of the processes."""
        return self._pool.list_processes()

    def make_submit(self, matcher: MonitoredMatcher, factory: MatcherFactory, reporter: Reporter) -> Submit:
        """Return what begins to match a frame set for a matcher, which completes it; ``factory`` makes its like."""
        workers = MatchWorkers(self._pool, factory, lambda _: {}, reporter, sends_images=True)
        return lambda frame_set: matcher.submit(frame_set, workers)

    def close(self) -> None:
        """End the processes."""
        self._pool.close()


def open_live_workers(setting: int | Literal["auto"]) -> LiveWorkers | None:
    """Return the workers for the setting; None where frame sets are matched in this process."""
    count = count_workers(setting)
    return LiveWorkers(count) if count else None
