"""The filling of holes in fused rows of belt, and the sums over each row."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.measure.flow.fusion.empty_belt_reference import EmptyBeltReference
from beltscape.measure.flow.fusion.fuse import FusedRows
from beltscape.measure.flow.settings import FlowSettings
from beltscape.measure.holes.fill import Filled, fill_holes
from beltscape.measure.surface import close_pinholes
from beltscape.measure.volume.uncertainty import EDGE_PX, STEP_SLOPE

_MIN_SHARE = 0.02
"""A row with a smaller measured share counts as not in view."""
_MIN_RIM_SHARE = 0.5
"""The limit beside a gap, where only low surfaces are in view."""
_LOWER_SIGMA = 0.8
"""Cells that none of many frames measured lie lower, by this many σ, than cells that one frame does not measure, on
which the networks were trained: by 0.6, 0.7 and 1.1 on three simulated heaps."""
_COMMON = 0.35
"""Share of the holes' σ that is common to all holes: the variation between materials."""


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Sums over each of n rows of belt; row j reaches from (j - ½) to (j + ½) cells in s."""

    first: int
    """Number of the first row."""
    area_mm2: NDArray[np.float64]
    """(n,) cross-section of the load."""
    share: NDArray[np.float64]
    """(n,) share of the row that was measured."""
    single_share: NDArray[np.float64]
    """(n,) share of the row that one frame measures on average."""
    apart_mm5: NDArray[np.float64]
    """(n,) variance per mm of belt of errors that are independent over long stretches: noise and holes."""
    edges_mm2: NDArray[np.float64]
    """(n,) σ of the volume per mm of belt due to the common displacement of all edges."""
    holes_mm2: NDArray[np.float64]
    """(n,) σ of the volume per mm of belt due to the common error of all filled holes."""

    def __len__(self) -> int:
        return len(self.area_mm2)


@dataclass(frozen=True, slots=True, eq=False)
class BeltPiece:
    """A finished piece of the fused belt, for pictures."""

    first: int
    """Number of the first row; row j is at s = j · cell."""
    height_mm: NDArray[np.float32]
    """(n, Nx) load over the empty belt, holes filled."""
    sigma_mm: NDArray[np.float32]
    """(n, Nx) σ of ``height_mm``."""
    measured: NDArray[np.bool_]
    """(n, Nx) whether any frame measured the cell."""


PieceCallback = Callable[[BeltPiece], None]


class RowFiller:
    """Fills the holes of fused rows block by block, the same blocks of belt whatever the frame rate.

    A stretch without any measured row ends a segment; what comes after begins another.
    """

    def __init__(
        self, ground: EmptyBeltReference, settings: FlowSettings, watch: PieceCallback | None
    ) -> None:
        """``watch`` receives every finished piece of belt."""
        self._ground, self._watch = ground, watch
        self._block = max(1, round(settings.block_mm / ground.cell_mm))
        self._margin = max(1, round(settings.margin_mm / ground.cell_mm))
        self._rows: list[NDArray[np.float64]] = []
        """Stacks (6, n, Nx) of the open segment: height, σ, noise; and by row: frames, single share, ray slope."""
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
        return self._first + sum(part.shape[1] for part in self._rows)

    def add(self, fused: FusedRows) -> list[Rows]:
        """Add further rows and return the finished ones."""
        layer = fused.layer
        out = self.mark_unseen(layer.first)
        columns = layer.height_mm.shape[1]
        by_row = [
            np.repeat(values[:, None], columns, axis=1)
            for values in (fused.frames, fused.single_share, layer.ray_slope)
        ]
        stack = np.stack([layer.height_mm, layer.sigma_mm, layer.noise_mm, *by_row]).astype(np.float64)
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
            self._rows.append(stack[:, first:stop])
            out += self._fill_ready_blocks(closed=False)
        return out

    def mark_unseen(self, row: int) -> list[Rows]:
        """Mark the rows up to ``row`` as not in view; beyond the margin this ends the segment."""
        if not self._rows or row - self._end <= self._margin:
            return []
        self._after_gap = True
        whole = np.concatenate(self._rows, axis=1)
        complete_rows = np.flatnonzero(np.isfinite(whole[0]).mean(axis=1) >= _MIN_RIM_SHARE)
        end = max(int(complete_rows[-1]) + 1 if len(complete_rows) else 0, self._done - self._first)
        self._rows = [whole[:, :end]]
        return self.close()

    def _append_blank_rows(self, row: int) -> None:
        """Append rows that were not in view, up to one that was."""
        if self._rows and row > self._end:
            shape = (6, row - self._end, self._rows[-1].shape[2])
            blank = np.full(shape, np.nan)
            blank[3:] = 0.0
            self._rows.append(blank)

    def close(self) -> list[Rows]:
        """End the segment and return its remaining rows."""
        if not self._rows:
            return []
        out = self._fill_ready_blocks(closed=True)
        self._rows = []
        return out

    def _fill_ready_blocks(self, *, closed: bool) -> list[Rows]:
        """Fill the blocks whose margins are complete."""
        out: list[Rows] = []
        end = self._end
        ready = end if closed else end - self._margin
        while self._done < ready:
            stop = (self._done // self._block + 1) * self._block
            if stop > ready and not closed:
                break
            out.append(self._fill_block(min(stop, ready), min(end, min(stop, ready) + self._margin)))
        return out

    def _fill_block(self, stop: int, ahead: int) -> Rows:
        """Fill the rows up to ``stop``, using those up to ``ahead``."""
        whole = np.concatenate(self._rows, axis=1)
        behind = max(self._first, self._done - self._margin)
        height, sigma, noise, frames, single, ray_slope = whole[:, behind - self._first : ahead - self._first]
        measured = close_pinholes(np.isfinite(height))
        slopes = np.stack([np.broadcast_to(self._ground.ray_slope_across(), height.shape), ray_slope])
        narrow = measured & ~np.isfinite(height)
        own = slice(self._done - behind, stop - behind)
        requested = slice(max(own.start - 1, 0), own.stop)  # steps are looked for from the row before
        filled = fill_holes(height, sigma, narrow, self._ground.cell_mm, slopes, rows=requested)
        filled = _lower_holes(filled, frames)
        rows = self._sum_rows(filled, noise, measured, single[:, 0], own)
        if self._watch is not None:
            parts = (filled.value_mm[own].astype(np.float32), filled.sigma_mm[own].astype(np.float32))
            self._watch(BeltPiece(self._done, *parts, measured[own]))
        self._done = stop
        keep = max(self._first, stop - self._margin)
        self._rows, self._first = [whole[:, keep - self._first :]], keep
        return rows

    def _sum_rows(
        self,
        filled: Filled,
        noise: NDArray[np.float64],
        measured: NDArray[np.bool_],
        single: NDArray[np.float64],
        own: slice,
    ) -> Rows:
        """Sums over the rows ``own`` of a filled block."""
        cell = self._ground.cell_mm
        shared = np.where(measured, np.nan_to_num(noise), 0.0)
        sampling = np.clip(np.where(measured, filled.sigma_mm, 0.0) ** 2 - shared**2, 0, None)
        apart = cell * self._ground.patch_mm2 * (shared**2).sum(axis=1) + cell**3 * sampling.sum(axis=1)
        open_mm = np.where(measured, 0.0, filled.sigma_mm)[own]
        label = np.zeros(open_mm.shape, np.int32)
        ndimage.label(open_mm > 0, np.ones((3, 3)), output=label)
        # a hole's variance (Σ cell² σ)² is distributed over its rows by their part of the sum
        whole = cell**2 * np.bincount(label.ravel(), open_mm.ravel())
        holes = (whole[label] * open_mm).sum(axis=1) * cell
        rise_x = np.abs(np.diff(filled.value_mm, axis=1, prepend=filled.value_mm[:, :1]))
        rise_y = np.abs(np.diff(filled.value_mm, axis=0, prepend=filled.value_mm[:1]))
        steps = sum((np.where(rise > STEP_SLOPE * cell, rise, 0.0)).sum(axis=1) for rise in (rise_x, rise_y))
        return Rows(
            first=self._done,
            area_mm2=cell * filled.value_mm[own].sum(axis=1),
            share=measured[own].mean(axis=1),
            single_share=single[own],
            apart_mm5=apart[own] + holes,
            edges_mm2=EDGE_PX * cell * np.asarray(steps)[own],
            holes_mm2=_COMMON * cell * open_mm.sum(axis=1),
        )


def _lower_holes(filled: Filled, frames: NDArray[np.float64]) -> Filled:
    """Lower the holes, the more frames (Ny, Nx) had them in view, but not from above the belt to below it."""
    low = filled.value_mm - _LOWER_SIGMA * (1 - 1 / np.maximum(frames, 1)) * filled.sigma_mm
    value = np.where(filled.hole, np.fmax(low, np.fmin(filled.value_mm, 0.0)), filled.value_mm)
    return Filled(value, filled.sigma_mm, filled.hole)


def _find_runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the stretches of equal flags as (first, end)."""
    cuts = [0, *(np.flatnonzero(np.diff(flags)) + 1).tolist(), len(flags)]
    return [(a, b) for a, b in pairwise(cuts) if b > a]
