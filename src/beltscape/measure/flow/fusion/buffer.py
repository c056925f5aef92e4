"""The frames that still see the belt: laid over one another, fused when the belt has left the view."""

from __future__ import annotations

import numpy as np

from beltscape.measure.flow.fusion.empty_belt_reference import Ground
from beltscape.measure.flow.fusion.fuse import Scatter, fuse
from beltscape.measure.flow.fusion.layer import Layer
from beltscape.measure.flow.fusion.rows import Filler, Rows
from beltscape.measure.flow.settings import FlowSettings


class Buffer:
    """Holds so many frames as the settings allow for one place; of a slow belt's, those that moved on far enough."""

    def __init__(self, ground: Ground, settings: FlowSettings, filler: Filler) -> None:
        """Finished rows go through ``filler``."""
        self._ground, self._filler = ground, filler
        self.step_mm = (ground.seen_mm[1] - ground.seen_mm[0]) / settings.layers
        """Frames that are kept are at least so far apart; the newest frame is kept until the next comes."""
        self.scatter = Scatter()
        self._layers: list[Layer] = []
        self._kept_mm: float | None = None
        self._newest: Layer | None = None
        self._next: int | None = None

    @property
    def open_mm(self) -> float:
        """Where a piece of belt begins that is being filled; infinite if there is none."""
        row = self._filler.open_row
        return np.inf if row is None else (row - 0.5) * self._ground.cell_mm

    def lay(self, layer: Layer, position_mm: float) -> None:
        """Take in a frame at a belt position."""
        if self._kept_mm is None or abs(position_mm - self._kept_mm) >= self.step_mm:
            self._layers.append(layer)
            self._kept_mm, self._newest = position_mm, None
        else:
            self._newest = layer
        if self._next is None:
            self._next = layer.first

    def clear(self) -> None:
        """Forget the frames: they were laid the wrong way round."""
        self._layers, self._kept_mm, self._newest = [], None, None

    def leave(self, until_mm: float) -> list[Rows]:
        """Finished rows, now that belt before ``until_mm`` has left the view."""
        return self._fuse(int(np.floor(until_mm / self._ground.cell_mm)))

    def close(self) -> list[Rows]:
        """Finished rows, now that no frame comes any more."""
        out = self._fuse(max((layer.end for layer in self._all()), default=0))
        return out + self._filler.close()

    def _all(self) -> list[Layer]:
        return self._layers if self._newest is None else [*self._layers, self._newest]

    def _fuse(self, until: int) -> list[Rows]:
        if self._next is None or until <= self._next:
            return []
        out: list[Rows] = []
        for first, end in self._covered(self._next, until):
            fused = fuse(self._all(), first, end)
            self.scatter = self.scatter + fused.scatter
            out += self._filler.add(fused)
        out += self._filler.reached(until)
        self._next = until
        self._layers = [layer for layer in self._layers if layer.end > until]
        return out

    def _covered(self, first: int, end: int) -> list[tuple[int, int]]:
        """Stretches of rows that some frame has in view, in order."""
        out: list[tuple[int, int]] = []
        for layer in sorted(self._all(), key=lambda one: one.first):
            low, high = max(layer.first, first), min(layer.end, end)
            if high <= low:
                continue
            if out and low <= out[-1][1]:
                out[-1] = (out[-1][0], max(out[-1][1], high))
            else:
                out.append((low, high))
        return out
