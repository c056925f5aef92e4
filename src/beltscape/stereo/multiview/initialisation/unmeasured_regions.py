"""Which blocks of a grid are still without a surface: what has come into view, and holes."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.initialisation.plane_sweep import Block

_LONE_PX = 48
_MISSING = 0.5
"""A place is missing when that share of the pixels about it is; smaller gaps are left to their neighbours."""
_AROUND_PX = 32
_MOST = 0.8
"""Where blocks cover so much, all is swept at once."""


def find_unmeasured_blocks(s: NDArray[np.float32], align: int) -> tuple[list[Block], list[Block]]:
    """Blocks about the pixels without a surface: strips that have come into view, and holes between what is known.

    Strips are whole rows or columns, from an edge on, of which most is missing. Blocks begin at multiples of
    ``align``, and are wider than what is missing, so that the aggregation's paths come from somewhere. Lone pixels
    do not count: their neighbours are all there is to fill them with. One strip, of all, where most is missing.
    """
    tile = align * -(-_AROUND_PX // align)
    missing = local_share(~np.isfinite(s)) > _MISSING
    strips = _strips(missing, tile)
    for strip in strips:
        missing[strip] = False
    holes = _holes(missing, tile)
    if sum(_area(block) for block in strips + holes) > _MOST * s.size:
        return [(slice(0, s.shape[0]), slice(0, s.shape[1]))], []
    return strips, holes


def local_share(of: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(H, W) of the pixels about each; the image's edge goes on as it is, so that strips along it count."""
    window = (_LONE_PX, _LONE_PX)
    return np.asarray(cv2.blur(of.astype(np.float32), window, borderType=cv2.BORDER_REPLICATE), np.float32)


def _strips(missing: NDArray[np.bool_], tile: int) -> list[Block]:
    """Rows, or columns, whichever are more, from an edge of the image on of which most is missing."""
    height, width = missing.shape
    rows, columns = (_runs(missing.mean(axis=1 - axis) > _MISSING, tile) for axis in (0, 1))
    if sum(run.stop - run.start for run in rows) * width >= sum(r.stop - r.start for r in columns) * height:
        return [(run, slice(0, width)) for run in rows]
    return [(slice(0, height), run) for run in columns]


def _runs(of: NDArray[np.bool_], tile: int) -> list[slice]:
    """Runs of tiles from either end on with one of these, or half a tile from one."""
    wide = np.convolve(of, np.ones(tile + 1), "same") > 0
    edges = np.flatnonzero(np.diff(np.pad(_tiles(wide, tile, 0).astype(np.int8), 1)))
    runs = [_whole(first, last, tile, len(of)) for first, last in edges.reshape(-1, 2).tolist()]
    return [run for run in runs if run.start == 0 or run.stop == len(of)]


def _holes(missing: NDArray[np.bool_], tile: int) -> list[Block]:
    """Boxes of tiles about what hangs together, half a tile wider at least."""
    height, width = missing.shape
    wide = cv2.dilate(missing.astype(np.uint8), np.ones((tile + 1, tile + 1), np.uint8)) > 0
    tiles = _tiles(_tiles(wide, tile, 0), tile, 1)
    _, _, boxes, _ = cv2.connectedComponentsWithStats(tiles.astype(np.uint8))
    return [
        (_whole(top, top + down, tile, height), _whole(left, left + across, tile, width))
        for left, top, across, down, _ in boxes[1:].tolist()
    ]


def _tiles(of: NDArray[np.bool_], tile: int, axis: int) -> NDArray[np.bool_]:
    """Which tiles along an axis hold one of these."""
    return np.logical_or.reduceat(of, np.arange(0, of.shape[axis], tile), axis=axis)


def _whole(first: int, last: int, tile: int, size: int) -> slice:
    return slice(first * tile, min(size, last * tile))


def _area(block: Block) -> int:
    return (block[0].stop - block[0].start) * (block[1].stop - block[1].start)
