"""Matching of a sequence's frames side by side: while one frame is measured, the next ones are matched already."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterable
from concurrent.futures import ThreadPoolExecutor

from beltscape.core.frames import FrameSet
from beltscape.core.system_calls import count_usable_cores
from beltscape.pipeline.reconstructing.checked_matcher import CheckedMatcher, PendingMatch

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
    side_by_side = 1 if is_large else max(1, min(_MOST_FRAMES, cores, frames))
    return side_by_side, max(1, cores // side_by_side)


def match_ahead(
    frames: Iterable[FrameSet], matcher: CheckedMatcher, side_by_side: int
) -> Generator[tuple[FrameSet, PendingMatch | None]]:
    """Yield the frames in order, each with its match, which was begun while the frames before it were measured.

    At most ``side_by_side`` frames are matched at a time, and one more is read; a single one is left to the caller.
    """
    if side_by_side < 2:
        yield from ((frame_set, None) for frame_set in frames)
        return
    pool = ThreadPoolExecutor(side_by_side)
    waiting: deque[tuple[FrameSet, PendingMatch | None]] = deque()
    try:
        for frame_set in frames:
            waiting.append((frame_set, matcher.submit(frame_set, pool)))
            if len(waiting) > side_by_side:
                yield waiting.popleft()
        while waiting:
            yield waiting.popleft()
    finally:
        pool.shutdown(cancel_futures=True)
