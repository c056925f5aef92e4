"""The queue between cameras and matcher."""

from __future__ import annotations

from beltscape.pipeline.live.intake import FrameQueue
from tests.pipeline.live.feed import (
    track,
)


def test_queue_keeps_the_newest_frames_in_order() -> None:
    queue = FrameQueue(2)
    for one in track(0, 300):
        queue.put(one)
    assert queue.dropped == 3
    taken = [queue.get(0), queue.get(0)]
    assert [one.frame for one in taken if one is not None] == ["180.0", "240.0"]
    assert queue.get(0.01) is None
    queue.close()
    assert queue.closed
