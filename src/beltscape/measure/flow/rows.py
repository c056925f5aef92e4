"""Rows of fused belt: the layers still in view, and the blocks of finished rows whose holes are filled.

Layers are fused when their belt has left the view. For reports the belt is kept from end to end at a reduced
resolution.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from beltscape.core.height_map import HeightMap
from beltscape.measure.belt.reference import EmptyBeltReference, Layer
from beltscape.measure.flow.blocks import (
    BeltBlock,
    BeltPiece,
    BlockGrid,
    PendingRows,
    PieceCallback,
    fill_block,
)
from beltscape.measure.flow.fuse import FusedRows, Scatter, fuse
from beltscape.measure.flow.settings import FlowSettings
from beltscape.workers.calls import CallMaker, CallsHere
from beltscape.workers.transport import SharedObject

_MIN_SHARE = 0.02
"""A row with a smaller measured share counts as not in view."""
_MIN_RIM_SHARE = 0.5
"""The limit beside a gap, where only low surfaces are in view."""


@dataclass(frozen=True, slots=True, eq=False)
class _FusedPart:
    """Successive rows of fused belt."""

    planes: NDArray[np.float32]
    """(3, n, Nx) height, σ and noise, mm."""
    by_row: NDArray[np.float64]
    """(4, n) number of frames, single share, ray slope, σ of the mean height from false depths."""

    def __len__(self) -> int:
        return self.planes.shape[1]

    def cut(self, first: int, end: int | None = None) -> _FusedPart:
        """Return some of the rows."""
        return _FusedPart(self.planes[:, first:end], self.by_row[:, first:end])


def _join(parts: Sequence[_FusedPart]) -> _FusedPart:
    """Return the rows of all parts."""
    return _FusedPart(
        np.concatenate([part.planes for part in parts], axis=1),
        np.concatenate([part.by_row for part in parts], axis=1),
    )


class RowFiller:
    """Fills the holes of fused rows block by block, the same blocks of belt whatever the frame rate.

    A stretch without any measured row ends a segment; what comes after begins another.
    """

    def __init__(
        self,
        ground: EmptyBeltReference,
        settings: FlowSettings,
        watch: PieceCallback | None,
        calls: CallMaker | None = None,
    ) -> None:
        """``watch`` receives every finished piece of belt; ``calls`` fills the blocks, None: each at once."""
        self._watch, self._calls = watch, calls or CallsHere()
        self._grid = SharedObject(BlockGrid(ground.cell_mm, ground.ray_slope_across(), ground.patch_mm2))
        self._block = max(1, round(settings.block_mm / ground.cell_mm))
        self._margin = max(1, round(settings.margin_mm / ground.cell_mm))
        self._rows: list[_FusedPart] = []
        """The rows of the open segment."""
        self._first = 0
        self._done = 0
        self._after_gap = False

    @property
    def open_row(self) -> int | None:
        """Return the next row to be filled of the open segment; None without one."""
        return self._done if self._rows else None

    @property
    def _end(self) -> int:
        """Return the number of the row after the segment's last."""
        return self._first + sum(map(len, self._rows))

    def add(self, fused: FusedRows) -> list[PendingRows]:
        """Add further rows and return those whose block is complete."""
        layer = fused.layer
        out = self.mark_unseen(layer.first)
        added = _FusedPart(
            np.stack([layer.height_mm, layer.sigma_mm, layer.noise_mm]),
            np.stack([fused.frames, fused.single_share, layer.ray_slope, fused.false_mm]).astype(np.float64),
        )
        seen = layer.share >= _MIN_SHARE
        for start, stop in _find_runs(seen):
            if not seen[start]:
                out += self.mark_unseen(layer.first + stop)
                continue
            if not self._rows:
                # a start after a gap needs a larger measured share, as does the end before it
                complete_rows = np.flatnonzero(
                    layer.share[start:stop] >= (_MIN_RIM_SHARE if self._after_gap else _MIN_SHARE)
                )
                if not len(complete_rows):
                    continue
                first = start + int(complete_rows[0])
                self._first = self._done = layer.first + first
            else:
                first = start
                self._append_blank_rows(layer.first + first)
            self._rows.append(added.cut(first, stop))
            out += self._fill_ready_blocks(closed=False)
        return out

    def mark_unseen(self, row: int) -> list[PendingRows]:
        """Mark the rows up to ``row`` as not in view; beyond the margin this ends the segment."""
        if not self._rows or row - self._end <= self._margin:
            return []
        self._after_gap = True
        whole = _join(self._rows)
        complete_rows = np.flatnonzero(np.isfinite(whole.planes[0]).mean(axis=1) >= _MIN_RIM_SHARE)
        end = max(int(complete_rows[-1]) + 1 if len(complete_rows) else 0, self._done - self._first)
        self._rows = [whole.cut(0, end)]
        return self.close()

    def _append_blank_rows(self, row: int) -> None:
        """Append rows that were not in view, up to one that was."""
        if self._rows and row > self._end:
            columns, count = self._rows[-1].planes.shape[2], row - self._end
            blank = np.full((3, count, columns), np.nan, np.float32)
            self._rows.append(_FusedPart(blank, np.zeros((4, count))))

    def close(self) -> list[PendingRows]:
        """End the segment and return its remaining rows."""
        if not self._rows:
            return []
        out = self._fill_ready_blocks(closed=True)
        self._rows = []
        return out

    def _fill_ready_blocks(self, *, closed: bool) -> list[PendingRows]:
        """Fill the blocks whose margins are complete."""
        out: list[PendingRows] = []
        end = self._end
        ready = end if closed else end - self._margin
        while self._done < ready:
            stop = (self._done // self._block + 1) * self._block
            if stop > ready and not closed:
                break
            out.append(self._fill_block(min(stop, ready), min(end, min(stop, ready) + self._margin)))
        return out

    def _fill_block(self, stop: int, ahead: int) -> PendingRows:
        """Begin to fill the rows up to ``stop``, using those up to ``ahead``."""
        whole = _join(self._rows)
        behind = max(self._first, self._done - self._margin)
        near = whole.cut(behind - self._first, ahead - self._first)
        own = self._done - behind, stop - behind
        has_piece = self._watch is not None
        # contiguous: on its way to a worker it is copied once
        block = BeltBlock(
            self._grid, np.ascontiguousarray(near.planes), near.by_row, own, self._done, has_piece
        )
        self._done = stop
        keep = max(self._first, stop - self._margin)
        self._rows, self._first = [whole.cut(keep - self._first)], keep
        return PendingRows(self._calls.begin(fill_block, block), self._watch)


def _find_runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the stretches of equal flags as (first, end)."""
    cuts = [0, *(np.flatnonzero(np.diff(flags)) + 1).tolist(), len(flags)]
    return [(a, b) for a, b in pairwise(cuts) if b > a]


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

    def fuse_until(self, until_mm: float) -> list[PendingRows]:
        """Return the rows of the blocks that are complete when the belt before ``until_mm`` has left the view."""
        return self._fuse(int(np.floor(until_mm / self._ground.cell_mm)))

    def close(self) -> list[PendingRows]:
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

    def _fuse(self, until: int) -> list[PendingRows]:
        if self._next is None or until <= self._next:
            return []
        out: list[PendingRows] = []
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


PICTURE_CELL_MM = 4.0
"""Edge, nearly, of the coarsest cells that the picture takes by itself."""
_LONGEST_ROWS, _MOST_CELLS = 50_000, 16_000_000
"""Rows and cells kept for the picture, 200 m of belt and 0.5 GB; older ones are dropped, which bounds the memory."""


class BeltPicture:
    """Collects finished pieces of belt as means over blocks of cells; very long belts lose their oldest part."""

    def __init__(self, ground: EmptyBeltReference, cell_mm: float | None = None) -> None:
        """Use blocks of an empty-belt reference's cells, with an edge near ``cell_mm``.

        By default a block is one cell, and twice as wide when there are too many, up to some `PICTURE_CELL_MM`.
        """
        self._cell_mm = ground.cell_mm
        self._x_mm = ground.grid.origin_mm[0]
        self._side = 1 if cell_mm is None else max(1, round(cell_mm / ground.cell_mm))
        self._coarsest_mm = PICTURE_CELL_MM if cell_mm is None else 0.0
        self._parts: dict[int, NDArray[np.float64]] = {}
        """For each row of blocks: (4, m) sums of height, of measured cells and of σ, and the number of rows."""
        self.is_shortened = False
        """Whether the oldest part was dropped."""

    @property
    def cell_mm(self) -> float:
        """Return the edge of a block."""
        return self._side * self._cell_mm

    def add(self, piece: BeltPiece) -> None:
        """Add a finished piece."""
        columns = piece.height_mm.shape[1] // self._side * self._side
        rows = piece.first + np.arange(len(piece.height_mm))
        for block in np.unique(rows // self._side):
            own = rows // self._side == block
            planes = (piece.height_mm, piece.measured, piece.sigma_mm)
            values = np.stack([plane[own, :columns] for plane in planes]).astype(np.float64)
            sums = values.sum(axis=1).reshape(len(planes), -1, self._side).mean(axis=2)
            sums = np.vstack([sums, np.full(sums.shape[1], own.sum())])
            self._parts[int(block)] = self._parts.get(int(block), 0.0) + sums
        while self._is_full():
            if self.cell_mm < self._coarsest_mm:
                self._double_blocks()
            else:
                del self._parts[next(iter(self._parts))]
                self.is_shortened = True

    def _is_full(self) -> bool:
        """Return whether there are more blocks than the picture may hold."""
        columns = next(iter(self._parts.values())).shape[1]
        return len(self._parts) > min(_LONGEST_ROWS, _MOST_CELLS // max(columns, 1))

    def _double_blocks(self) -> None:
        """Join the blocks two by two across and along the belt."""
        parts, self._parts, self._side = self._parts, {}, 2 * self._side
        for block, part in parts.items():
            columns = part.shape[1] // 2
            joined = part[:, : 2 * columns].reshape(len(part), columns, 2).mean(axis=2)
            self._parts[block // 2] = self._parts.get(block // 2, 0.0) + joined

    def height_map(self) -> tuple[HeightMap, NDArray[np.float64]]:
        """Return heights over the empty belt on x and s, NaN outside all views, and the share of measured cells.

        σ of a block is the mean of its cells' σ, whose errors are hardly independent so close together.
        """
        if not self._parts:
            empty = np.full((1, 1), np.nan)
            return HeightMap(empty, empty, (self._x_mm, 0.0), self.cell_mm), np.zeros((1, 1))
        first, last = min(self._parts), max(self._parts)
        columns = next(iter(self._parts.values())).shape[1]
        sums = np.full((4, last - first + 1, columns), np.nan)
        for block, part in self._parts.items():
            sums[:, block - first] = part
        middle = 0.5 * (self._side - 1) * self._cell_mm
        origin = (self._x_mm + middle, first * self.cell_mm + middle)
        height, share, sigma = sums[:3] / sums[3]
        return HeightMap(height, sigma, origin, self.cell_mm), np.nan_to_num(share)
