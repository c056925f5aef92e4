"""The layers whose belt is still in view, fused when the belt has left it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from beltscape.measure.flow.fusion.empty_belt_reference import EmptyBeltReference
from beltscape.measure.flow.fusion.fuse import Scatter, fuse
from beltscape.measure.flow.fusion.layer import Layer
from beltscape.measure.flow.fusion.rows import RowFiller, Rows
from beltscape.measure.flow.settings import FlowSettings


class LayerBuffer:
    """Holds the layers that the settings allow for one position; of a slow belt, those that moved far enough."""

    def __init__(self, ground: EmptyBeltReference, settings: FlowSettings, filler: RowFiller) -> None:
        """Finished rows go through ``filler``."""
        self._ground, self._filler = ground, filler
        self.step_mm = (ground.seen_mm[1] - ground.seen_mm[0]) / settings.layers
        """Least distance between kept frames; the newest frame is kept until the next one."""
        self.scatter = Scatter()
        self._layers: list[Layer] = []
        self._kept_mm: float | None = None
        self._newest: Layer | None = None
        self._next: int | None = None

    @property
    def open_mm(self) -> float:
        """Return the start of the piece of belt that is being filled; infinite if there is none."""
        row = self._filler.open_row
        return np.inf if row is None else (row - 0.5) * self._ground.cell_mm

    def add(self, layer: Layer, position_mm: float) -> None:
        """Add a frame's layer at a belt position."""
        if self._kept_mm is None or abs(position_mm - self._kept_mm) >= self.step_mm:
            self._layers.append(layer)
            self._kept_mm, self._newest = position_mm, None
        else:
            self._newest = layer
        if self._next is None:
            self._next = layer.first

    def move(self, moves_mm: Mapping[int, float]) -> None:
        """Move the layers of these frames along the belt, by whole cells."""
        if self._layers and self._kept_mm is not None:
            self._kept_mm += moves_mm.get(self._layers[-1].frame, 0.0)
        self._layers = [self._move_layer(layer, moves_mm) for layer in self._layers]
        if self._newest is not None:
            self._newest = self._move_layer(self._newest, moves_mm)

    def _move_layer(self, layer: Layer, moves_mm: Mapping[int, float]) -> Layer:
        return replace(
            layer, first=layer.first + round(moves_mm.get(layer.frame, 0.0) / self._ground.cell_mm)
        )

    def clear(self) -> None:
        """Discard the layers, which were added for the wrong direction."""
        self._layers, self._kept_mm, self._newest = [], None, None

    def discard_from(self, frame: int) -> None:
        """Discard the layers of a frame and of those after it."""
        self._layers = [layer for layer in self._layers if layer.frame < frame]
        if self._newest is not None and self._newest.frame >= frame:
            self._newest = None

    def fuse_until(self, until_mm: float) -> list[Rows]:
        """Return the rows finished when the belt before ``until_mm`` has left the view."""
        return self._fuse(int(np.floor(until_mm / self._ground.cell_mm)))

    def close(self) -> list[Rows]:
        """Return the remaining rows after the last frame."""
        out = self._fuse(max((layer.end for layer in self._list_layers()), default=0))
        return out + self._filler.close()

    def leave_out(self, frame: int, cells: NDArray[np.bool_], direction: int) -> None:
        """Leave cells (Ny, Nx) of a coarser static grid out of a frame's layer."""

        def change(layer: Layer) -> Layer:
            if layer.frame != frame:
                return layer
            return layer.leave_out(self._ground.refine(cells, layer.height_mm.shape)[::-direction])

        self._layers = [change(layer) for layer in self._layers]
        self._newest = None if self._newest is None else change(self._newest)

    def _list_layers(self) -> list[Layer]:
        return self._layers if self._newest is None else [*self._layers, self._newest]

    def _fuse(self, until: int) -> list[Rows]:
        if self._next is None or until <= self._next:
            return []
        out: list[Rows] = []
        for first, end in self._find_stretches_in_view(self._next, until):
            fused = fuse(self._list_layers(), first, end)
            self.scatter = self.scatter + fused.scatter
            out += self._filler.add(fused)
        out += self._filler.mark_unseen(until)
        self._next = until
        self._layers = [layer for layer in self._layers if layer.end > until]
        return out

    def _find_stretches_in_view(self, first: int, end: int) -> list[tuple[int, int]]:
        """Return the stretches of rows that any frame has in view, in order."""
        out: list[tuple[int, int]] = []
        for layer in sorted(self._list_layers(), key=lambda one: one.first):
            low, high = max(layer.first, first), min(layer.end, end)
            if high <= low:
                continue
            if out and low <= out[-1][1]:
                out[-1] = (out[-1][0], max(out[-1][1], high))
            else:
                out.append((low, high))
        return out
