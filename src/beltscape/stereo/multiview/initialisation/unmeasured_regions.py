"""Regions of the grid that have no surface yet: strips that came into view, and holes."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.initialisation.plane_sweep import Block

_WINDOW_PX = 48
"""Side of the window in which the share of unmeasured pixels is computed."""
_LEAST_SHARE = 0.5
"""Share of unmeasured pixels in the window above which a pixel is swept; propagation fills smaller gaps."""
_MARGIN_PX = 32
"""Least side of the tiles of which swept blocks consist."""
_MOST_AREA = 0.8
"""Share of the grid's area above which everything is swept at once."""


def find_unmeasured_blocks(s: NDArray[np.float32], align: int) -> tuple[list[Block], list[Block]]:
    """Return the blocks around pixels without a surface: strips at the edges, and holes inside.

    Strips are whole rows or columns, starting at an edge, that are mostly unmeasured. Blocks begin at multiples of
    ``align`` and extend beyond the unmeasured pixels, so that the aggregation's paths start on measured ones. Single
    pixels are left out: their neighbours fill them. Where most is unmeasured there is one strip of the whole grid.
    """
    tile = align * -(-_MARGIN_PX // align)
    missing = compute_local_share(~np.isfinite(s)) > _LEAST_SHARE
    strips = _find_strips(missing, tile)
    for strip in strips:
        missing[strip] = False
    holes = _find_holes(missing, tile)
    if sum(_compute_area(block) for block in strips + holes) > _MOST_AREA * s.size:
        return [(slice(0, s.shape[0]), slice(0, s.shape[1]))], []
    return strips, holes


def compute_local_share(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the (H, W) share of mask pixels around each pixel; the mask continues beyond the image's edge."""
    window = (_WINDOW_PX, _WINDOW_PX)
    return np.asarray(cv2.blur(mask.astype(np.float32), window, borderType=cv2.BORDER_REPLICATE), np.float32)


def _find_strips(missing: NDArray[np.bool_], tile: int) -> list[Block]:
    """Return the mostly unmeasured rows or columns at the edges, whichever cover more."""
    height, width = missing.shape
    rows, columns = (_find_edge_runs(missing.mean(axis=1 - axis) > _LEAST_SHARE, tile) for axis in (0, 1))
    if sum(run.stop - run.start for run in rows) * width >= sum(r.stop - r.start for r in columns) * height:
        return [(run, slice(0, width)) for run in rows]
    return [(slice(0, height), run) for run in columns]


def _find_edge_runs(mask: NDArray[np.bool_], tile: int) -> list[slice]:
    """Return the runs of tiles, starting at either end, that lie within half a tile of a mask element (N,)."""
    wide = np.convolve(mask, np.ones(tile + 1), "same") > 0
    edges = np.flatnonzero(np.diff(np.pad(_reduce_to_tiles(wide, tile, 0).astype(np.int8), 1)))
    runs = [_slice_tile(first, last, tile, len(mask)) for first, last in edges.reshape(-1, 2).tolist()]
    return [run for run in runs if run.start == 0 or run.stop == len(mask)]


def _find_holes(missing: NDArray[np.bool_], tile: int) -> list[Block]:
    """Return the boxes of tiles around connected unmeasured pixels, with a margin of at least half a tile."""
    height, width = missing.shape
    wide = cv2.dilate(missing.astype(np.uint8), np.ones((tile + 1, tile + 1), np.uint8)) > 0
    tiles = _reduce_to_tiles(_reduce_to_tiles(wide, tile, 0), tile, 1)
    _, _, boxes, _ = cv2.connectedComponentsWithStats(tiles.astype(np.uint8))
    return [
        (_slice_tile(top, top + down, tile, height), _slice_tile(left, left + across, tile, width))
        for left, top, across, down, _ in boxes[1:].tolist()
    ]


def _reduce_to_tiles(mask: NDArray[np.bool_], tile: int, axis: int) -> NDArray[np.bool_]:
    """Return which tiles along an axis contain an element of the mask."""
    return np.logical_or.reduceat(mask, np.arange(0, int(mask.shape[axis]), tile), axis=axis)


def _slice_tile(first: int, last: int, tile: int, size: int) -> slice:
    return slice(first * tile, min(size, last * tile))


def _compute_area(block: Block) -> int:
    return (block[0].stop - block[0].start) * (block[1].stop - block[1].start)
