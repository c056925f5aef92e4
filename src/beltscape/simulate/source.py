"""The simulated plant as a frame source: frame sets one after another, as many as requested."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import count

from beltscape.core.frames import FrameSet
from beltscape.simulate.scenario import Scenario
from beltscape.simulate.scene_assembly import SimulatedScene


class SimulatedSource:
    """A `FrameSource` of a scenario; endless unless the number of frames is given.

    On a moving belt the heap passes again and again, with a piece of empty belt in between; a calibration repeats the
    poses of its board.
    """

    def __init__(self, scenario: Scenario, *, frames: int | None = None) -> None:
        self.scene = SimulatedScene(scenario)
        self._frames = frames

    @property
    def cameras(self) -> tuple[str, ...]:
        """Return the names of the cameras."""
        return tuple(self.scene.station.rig.cameras)

    def __len__(self) -> int:
        return sys.maxsize if self._frames is None else self._frames

    def __iter__(self) -> Iterator[FrameSet]:
        for frame in count() if self._frames is None else range(self._frames):
            yield self.scene.render_frame(frame)
