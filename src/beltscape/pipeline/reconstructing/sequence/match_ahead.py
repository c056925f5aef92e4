"""Matching of a sequence's frames side by side: while one frame is measured, the next ones are matched already."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.core.runtime.system_calls import count_usable_cores
from beltscape.pipeline.reconstructing.checked_matcher import CheckedMatcher
from beltscape.pipeline.reconstructing.match_pool import FrameMatcher, MatchPool, PendingMatch

_MOST_FRAMES = 2
"""Frames that are matched side by side. The steps between the kernels run on one thread, so one frame keeps two cores
busy for about three quarters of its time; two frames on a thread each, for all of it."""
_MOST_PIXELS = 3_000_000
"""Pixels of a frame above which it is matched alone: the preset ``standard`` takes 550 bytes for each, so that two
frames of this size take 3.3 GB."""


def choose_threads(frames: int, size_px: tuple[int, int]) -> tuple[int, int]:
    """Return how many frames of a sequence to match side by side, and the number of threads for each of them."""
    cores = count_usable_cores()
    is_large = size_px[0] * size_px[1] > _MOST_PIXELS
    at_a_time = 1 if is_large else max(1, min(_MOST_FRAMES, cores, frames))
    return at_a_time, max(1, cores // at_a_time)


class MatchThreads:
    """Matches frames on threads of this process."""

    def __init__(self, pool: ThreadPoolExecutor) -> None:
        self._pool = pool

    def submit(
        self, frame_set: FrameSet, auxiliaries: tuple[str, ...], make_matcher: Callable[[], FrameMatcher]
    ) -> Future[DepthMap]:
        """Begin to match a frame; see `MatchPool`."""
        del auxiliaries
        return self._pool.submit(make_matcher().reconstruct, frame_set, Silent())


@contextmanager
def open_threads(at_a_time: int) -> Generator[MatchThreads]:
    """Yield threads that match frames; what is not begun at the end is left out."""
    pool = ThreadPoolExecutor(at_a_time)
    try:
        yield MatchThreads(pool)
    finally:
        pool.shutdown(cancel_futures=True)


def match_ahead(
    frames: Iterable[FrameSet], matcher: CheckedMatcher, pool: MatchPool, at_a_time: int
) -> Generator[tuple[FrameSet, PendingMatch | None]]:
    """Yield the frames in order, each with its match, which was begun while the frames before it were measured.

    At most ``at_a_time`` frames are handed out at a time, and one more is read; a single one is left to the caller.
    """
    if at_a_time < 2:
        yield from ((frame_set, None) for frame_set in frames)
        return
    waiting: deque[tuple[FrameSet, PendingMatch | None]] = deque()
    for frame_set in frames:
        waiting.append((frame_set, matcher.submit(frame_set, pool)))
        if len(waiting) > at_a_time:
            yield waiting.popleft()
    while waiting:
        yield waiting.popleft()
