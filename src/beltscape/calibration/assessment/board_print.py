"""Faults of a board's print that the adjustment measures: a stretched direction, and an AprilGrid's wrong spacing.

The adjustment finds where the board's corners are relative to each other, but no length: that is the stated one. A
print that is stretched in one direction, or whose gaps are not as described, has two lengths that contradict each
other. The rig has the size of their mean, and all that it measures is off by what the right one differs from that.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.core.arrays import Array
from beltscape.target.board import AprilGrid, Board, BoardSet, PlanarBoard

LEAST = 5e-4
"""Relative difference of lengths from which it is stated: half of it is the error of a caliper over a row of 300 mm,
and laser printers have 1e-3 to 5e-3."""
LEAST_SIGMAS = 4.0
"""The difference over its standard deviation from which it is stated."""
LEAST_EXTENT = 3
"""Corners along a row or column from which stretches and gaps are told apart."""


@dataclass(frozen=True, slots=True)
class PrintDistortion:
    """Print of a planar board against its drawing, with one standard deviation each."""

    rows: float
    """Lengths along rows, as the rig measures them, over the drawn ones, less 1."""
    columns: float
    """The same along columns."""
    stretch_sigma: float
    """Of the difference of the two."""
    tag: float
    """Tags' edges over those of the drawing, less 1, in excess of the distance from tag to tag; 0 of other boards."""
    tag_sigma: float

    @property
    def stretch(self) -> float:
        """Relative difference of the lengths along rows and along columns."""
        return self.rows - self.columns


def measure_print(board: PlanarBoard, corners_mm: Array, covariance: Array) -> PrintDistortion:
    """Return the distortion of a print from its measured corners (P, 3), up to a pose, and their covariance (3P, 3P).

    σ has two parts: that of the corners, with the lenses' aspect ratios, which a board that is never turned on its
    side leaves uncertain, and that of the print's own irregularity.
    """
    drawn = board.corners_mm()
    drawn = drawn - drawn.mean(axis=0)
    measured, turn = _align(drawn, corners_mm)
    design = _make_design(board, drawn)
    inverse = np.linalg.pinv(design)
    values = (measured - drawn).T.ravel()
    found = inverse @ values
    residual = values - design @ found
    variance = float(residual @ residual) / max(len(values) - len(found), 1)
    by_values = np.stack([inverse[2] - inverse[3], inverse[-1]])
    by_corners = np.einsum("kdn,jd->knj", by_values.reshape(2, 2, -1), turn).reshape(2, -1)
    sigma = np.sqrt(
        np.einsum("ki,ij,kj->k", by_corners, covariance, by_corners) + variance * (by_values**2).sum(axis=1)
    )
    is_grid = isinstance(board, AprilGrid)
    return PrintDistortion(
        rows=float(found[2]),
        columns=float(found[3]),
        stretch_sigma=float(sigma[0]),
        tag=float(found[-1]) if is_grid else 0.0,
        tag_sigma=float(sigma[1]) if is_grid else 0.0,
    )


def _make_design(board: PlanarBoard, drawn: Array) -> Array:
    """Return the moves (2P, 5) of corners, x of all before y, by shifts, lengths of rows and columns, and shear.

    (2P, 6) with that by the tags' size of an AprilGrid.
    """
    zeros, one, (x, y) = np.zeros(len(drawn)), np.ones(len(drawn)), drawn.T
    moves = [(one, zeros), (zeros, one), (x, zeros), (zeros, y), (y, x)]
    if isinstance(board, AprilGrid):
        columns, rows = board.grid
        index = np.arange(columns * rows)
        moves.append(
            (board.tag_mm * (index % columns % 2 - 0.5), board.tag_mm * (index // columns % 2 - 0.5))
        )
    return np.stack([np.concatenate(move) for move in moves], axis=1)


def _align(drawn: Array, corners_mm: Array) -> tuple[Array, Array]:
    """Return measured corners (P, 2) turned and shifted onto the drawing (P, 2), and the turn (3, 2) (Kabsch)."""
    flat = np.column_stack([drawn, np.zeros(len(drawn))])
    middle = corners_mm - corners_mm.mean(axis=0)
    u, _, vt = np.linalg.svd(middle.T @ flat)
    turn = (u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)[:, :2]
    return np.asarray(middle @ turn, np.float64), turn


def describe_print(board: Board, adjustment: BundleAdjustmentResult, inflation: float) -> list[str]:
    """Return a line for every contradiction of lengths of a board; ``inflation`` is that of σ by views' scatter."""
    shape_mm, corners_mm = adjustment.shape_mm, adjustment.geometry.points_mm
    if not np.any(shape_mm[:, :2]):
        return []
    covariance = inflation**2 * compute_corner_covariance(adjustment)
    lines: list[str] = []
    for name, own, rows in _list_faces(board):
        if min(own.grid) >= LEAST_EXTENT:
            block = slice(3 * rows.start, 3 * rows.stop)
            lines += _describe(name, own, measure_print(own, corners_mm[rows], covariance[block, block]))
    return lines


def compute_corner_covariance(adjustment: BundleAdjustmentResult) -> Array:
    """Return the covariance (3P, 3P) of the board's corners, mm²; 0 in directions that are not adjusted."""
    bundle = adjustment.bundle
    is_point = bundle.free >= bundle.point_start
    columns = bundle.free[is_point] - bundle.point_start
    count = 3 * len(adjustment.geometry.points_mm)
    covariance = np.zeros((count, count))
    found = adjustment.linearise().covariance()[: len(bundle.free), : len(bundle.free)]
    covariance[np.ix_(columns, columns)] = found[np.ix_(is_point, is_point)]
    return covariance


def _list_faces(board: Board) -> Iterator[tuple[str, PlanarBoard, slice]]:
    """Yield the name, the board and the corners of every print."""
    if not isinstance(board, BoardSet):
        yield "the board", board, slice(0, board.grid[0] * board.grid[1])
        return
    for face, first, last in zip(board.faces, board.offsets, board.offsets[1:], strict=False):
        yield f"board {face.name}", face.board, slice(first, last)


def _describe(name: str, board: PlanarBoard, found: PrintDistortion) -> Iterator[str]:
    if _is_stated(found.stretch, found.stretch_sigma):
        key = "tag_mm" if isinstance(board, AprilGrid) else "square_mm"
        yield (
            f"{name} is stretched: its rows are {abs(found.stretch):.2%} ± {found.stretch_sigma:.2%} "
            f"{'longer' if found.stretch > 0 else 'shorter'} than its columns, so that {key} = {board.square_mm:g} "
            f"holds in one direction only. Lengths of the rig are {_format_error(found.rows)} if it is right along "
            f"rows, {_format_error(found.columns)} if along columns: measure a long row, and give {key} of the row "
            f"over {1 + found.rows:.5f}"
        )
    if isinstance(board, AprilGrid) and _is_stated(found.tag, found.tag_sigma):
        pitch = (found.rows + found.columns) / 2
        yield (
            f"{name} has other gaps than described: spacing is {(board.spacing - found.tag) / (1 + found.tag):.4f}, "
            f"board.toml says {board.spacing:g}. Lengths of the rig are {_format_error(pitch + found.tag)} if tag_mm "
            f"is right, {_format_error(pitch)} if the distance from tag to tag is: measure both, correct board.toml "
            "and calibrate again"
        )


def _format_error(share: float) -> str:
    return f"{abs(share):.2%} too {'long' if share > 0 else 'short'}"


def _is_stated(value: float, sigma: float) -> bool:
    return abs(value) > max(LEAST, LEAST_SIGMAS * sigma)
