"""The queue between cameras and matcher."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.frames import FrameSet
from beltscape.pipeline.live.intake import FrameQueue
from tests.pipeline.live.feed import track


def test_queue_keeps_the_newest_frames_in_order() -> None:
    queue = FrameQueue(2)
    for one in track(0, 300):
        queue.put(one)
    assert queue.dropped == 3
    taken = [queue.get(0), queue.get(0)]
    assert [one.frames.frame for one in taken if one is not None] == ["180.0", "240.0"]
    assert queue.get(0.01) is None
    queue.close()
    assert queue.closed


def name_taken(queue: FrameQueue) -> list[str]:
    taken: list[str] = []
    while (one := queue.get(0)) is not None:
        taken.append(one.frames.frame)
    return taken


def put_at(queue: FrameQueue, *positions_mm: float) -> None:
    for position_mm in positions_mm:
        queue.put(FrameSet(f"{position_mm:g}", {}, position_mm=position_mm))


def test_what_shows_nothing_new_goes_first() -> None:
    queue = FrameQueue(3)
    put_at(queue, 0.0)
    queue.get(0)
    put_at(queue, 100.0, 200.0, 201.0, 202.0, 300.0)
    assert name_taken(queue) == ["100", "200", "300"]


@pytest.mark.parametrize("direction", [1, -1])
def test_views_stay_evenly_spaced_at_three_times_the_capacity(direction: int) -> None:
    queue, taken = FrameQueue(2), []
    for number in range(60):
        put_at(queue, 50.0 * direction * number)
        if number % 3 == 0:
            one = queue.get(0)
            assert one is not None
            taken.append(float(one.frames.frame))
    steps = np.abs(np.diff(taken[2:]))
    assert queue.dropped >= 38
    assert steps.max() <= 1.5 * steps.mean()


def test_without_positions_the_oldest_goes() -> None:
    queue = FrameQueue(2)
    for number in range(4):
        queue.put(FrameSet(str(number), {}))
    assert name_taken(queue) == ["2", "3"]
