"""The filling of holes in blocks of fused belt, and the sums over each row.

A block depends on the fused rows about it alone, so that any process may fill it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.measure.flow.continuation import continue_into_holes
from beltscape.measure.holes import Filled, fill_holes
from beltscape.measure.surface import close_pinholes
from beltscape.measure.volume.uncertainty import EDGE_PX, STEP_SLOPE
from beltscape.workers.calls import PendingCall
from beltscape.workers.transport import SharedObject

_LOWER_SIGMA = 0.4
"""Cells that none of many frames measured are put lower by this many σ: midway between the heaps of this program's
simulator, on nine of which 0.1 would be right, and the heap of another renderer, on which 0.7 would."""
_COMMON = 0.4
"""Share of the holes' σ that is common to all holes: errors over σ of the totals of these ten heaps are 0.8 RMS."""


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
    """(n,) σ of the volume per mm of belt due to the common displacement of all edges, and to false depths there."""
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
    """(n, Nx) load over the empty belt; in holes the most probable height, where `Rows` sum the mean."""
    sigma_mm: NDArray[np.float32]
    """(n, Nx) σ of ``height_mm``."""
    measured: NDArray[np.bool_]
    """(n, Nx) whether any frame measured the cell."""


PieceCallback = Callable[[BeltPiece], None]


@dataclass(frozen=True, slots=True, eq=False)
class BlockGrid:
    """What all blocks of an empty belt's grid have in common."""

    cell_mm: float
    ray_slope_across: NDArray[np.float64]
    """(Nx,) slope of the core's rays in x."""
    patch_mm2: float
    """Area over which the noise of heights is common."""


@dataclass(frozen=True, slots=True, eq=False)
class BeltBlock:
    """Successive fused rows, of which some are to be filled and the others are the margins."""

    grid: SharedObject[BlockGrid]
    planes: NDArray[np.float32]
    """(3, n, Nx) height, σ and noise, mm."""
    by_row: NDArray[np.float64]
    """(4, n) number of frames, single share, ray slope, σ of the mean height from false depths."""
    own: tuple[int, int]
    """The first row to fill, and the one after the last."""
    number: int
    """Number of the first row to fill."""
    has_piece: bool
    """Whether the piece for pictures is needed, too."""


@dataclass(frozen=True, slots=True, eq=False)
class BlockHoles:
    """The fused heights of a block with its margins, whose NaN cells are holes; cells (n, Nx)."""

    height_mm: NDArray[np.float64]
    sigma_mm: NDArray[np.float64]
    pinhole: NDArray[np.bool_]
    """Gaps between the points of neighbouring pixels."""
    measured: NDArray[np.bool_]
    """Measured cells, and these gaps."""
    ray_slope: NDArray[np.float64]
    """(2, n, Nx) slopes of the core's rays in x and y, means over the frames."""


@dataclass(frozen=True, slots=True, eq=False)
class FilledBlock:
    """The rows of a block."""

    rows: Rows
    piece: BeltPiece | None


def fill_block(block: BeltBlock) -> FilledBlock:
    """Fill the holes of a block: its rows sum means, its piece shows the most probable surface."""
    cell_mm, holes = block.grid.value.cell_mm, gather_holes(block)
    frames, single, _, false_mm = block.by_row
    first, end = block.own
    needed = slice(max(first - 1, 0), end)  # steps are looked for from the row before
    filled = fill_holes(holes.height_mm, holes.sigma_mm, holes.pinhole, cell_mm, holes.ray_slope, rows=needed)
    filled = _lower_holes(filled.cut(needed), frames[needed, None])
    own = slice(first - needed.start, end - needed.start)
    noise, measured = block.planes[2].astype(np.float64)[needed], holes.measured[needed]
    rows = _sum_rows(block, filled, noise, measured, single[needed], false_mm[needed], own)
    if not block.has_piece:
        return FilledBlock(rows, None)
    shown = continue_into_holes(filled, holes.height_mm, cell_mm, needed)
    parts = (shown.value_mm[own].astype(np.float32), shown.sigma_mm[own].astype(np.float32))
    return FilledBlock(rows, BeltPiece(block.number, *parts, measured[own]))


def gather_holes(block: BeltBlock) -> BlockHoles:
    """Return the heights of a block, and what their holes are filled by."""
    height, sigma, _ = block.planes.astype(np.float64)
    measured = close_pinholes(np.isfinite(height))
    slopes = np.empty((2, *height.shape))
    slopes[0], slopes[1] = block.grid.value.ray_slope_across, block.by_row[2][:, None]
    return BlockHoles(height, sigma, measured & ~np.isfinite(height), measured, slopes)


@dataclass(frozen=True, slots=True, eq=False)
class PendingRows:
    """Rows whose block is being filled."""

    filling: PendingCall[FilledBlock]
    on_piece: PieceCallback | None
    """Receives the block's piece."""

    @property
    def is_done(self) -> bool:
        """Return whether `finish` need not wait."""
        return self.filling.done()

    def finish(self) -> Rows:
        """Wait for the rows and return them; each block is finished once, in the order of the belt."""
        filled = self.filling.result()
        if self.on_piece is not None and filled.piece is not None:
            self.on_piece(filled.piece)
        return filled.rows


def _sum_rows(
    block: BeltBlock,
    filled: Filled,
    noise: NDArray[np.float64],
    measured: NDArray[np.bool_],
    single: NDArray[np.float64],
    false_mm: NDArray[np.float64],
    own: slice,
) -> Rows:
    """Sums over the rows ``own`` of a filled block, whose rows begin no more than one before."""
    grid = block.grid.value
    cell = grid.cell_mm
    shared = np.where(measured, np.nan_to_num(noise), 0.0)
    sampling = np.clip(np.where(measured, filled.sigma_mm, 0.0) ** 2 - shared**2, 0, None)
    apart = cell * grid.patch_mm2 * (shared**2).sum(axis=1) + cell**3 * sampling.sum(axis=1)
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
        first=block.number,
        area_mm2=cell * filled.value_mm[own].sum(axis=1),
        share=measured[own].mean(axis=1),
        single_share=single[own],
        apart_mm5=apart[own] + holes,
        edges_mm2=np.hypot(EDGE_PX * np.asarray(steps), measured.sum(axis=1) * false_mm)[own] * cell,
        holes_mm2=_COMMON * cell * open_mm.sum(axis=1),
    )


def _lower_holes(filled: Filled, frames: NDArray[np.float64]) -> Filled:
    """Lower the holes, the more frames (Ny, 1) had them in view, but not from above the belt to below it."""
    low = filled.value_mm - _LOWER_SIGMA * (1 - 1 / np.maximum(frames, 1)) * filled.sigma_mm
    value = np.where(filled.hole, np.fmax(low, np.fmin(filled.value_mm, 0.0)), filled.value_mm)
    return Filled(value, filled.sigma_mm, filled.hole)
