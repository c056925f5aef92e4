"""The 4×4 grid of the pattern's markers in one image: which is which, and where the hidden ones would be."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.core.camera import Camera
from beltscape.core.frames import Image
from beltscape.stereo.markers.lattice import find_lattice, placed, projective
from beltscape.stereo.markers.markers import Markers, find_markers

SIDE = 4
"""Markers to a side: blocks of the pattern (the paper's Eq. 6)."""


@dataclass(frozen=True, slots=True, eq=False)
class MarkerGrid:
    """The pattern's markers in one image; row and column as in the pattern up to whole quarter turns.

    A camera cannot know how it is turned about the pattern; `marker_agreement.agree` gives all cameras
    of a rig the same rows and columns.
    """

    size_px: tuple[int, int]
    """(width, height) of the image."""
    center_px: NDArray[np.float64]
    """(4, 4, 2) by row and column: u, v; of a marker that was not found, where it is expected from the others."""
    found: NDArray[np.bool_]
    """(4, 4) bool: seen; otherwise expected."""
    radius_px: NDArray[np.float64]
    """(4, 4) of the circle with the visible area; NaN where not found."""
    confidence: NDArray[np.float64]
    """(4, 4) 0..1; 0 where not found."""

    @property
    def count(self) -> int:
        """How many were found."""
        return int(self.found.sum())

    def undistorted(self, camera: Camera) -> MarkerGrid:
        """The same on the camera's undistorted grid; what the lens model cannot have put anywhere stays expected."""
        pixels = camera.undistort(self.center_px) * camera.focal_px + camera.center_px
        found = self.found & np.isfinite(pixels).all(axis=-1)
        moved = replace(self, center_px=np.where(found[..., None], pixels, np.nan), found=found)
        return _completed(moved) if found.sum() >= 3 else replace(self, found=found)

    def placements(self) -> list[MarkerGrid]:
        """Every way to say which row and column is which: four turns, all shifts that missing ones allow."""
        options = []
        for turn in range(4):
            turned = MarkerGrid(
                self.size_px,
                *(
                    np.rot90(a, turn, axes=(0, 1))
                    for a in (self.center_px, self.found, self.radius_px, self.confidence)
                ),
            )
            rows, columns = (np.flatnonzero(turned.found.any(axis=k)) for k in (1, 0))
            for down in range(-int(rows[0]), SIDE - int(rows[-1])):
                for right in range(-int(columns[0]), SIDE - int(columns[-1])):
                    options.append(_shifted(turned, down, right))
        return options


def find_marker_grid(image: Image) -> MarkerGrid | None:
    """The markers of an image (H, W) or (H, W, 3) in their rows and columns; None where no grid is seen."""
    height, width = image.shape[:2]
    return grid_of(find_markers(image), (width, height))


def grid_of(markers: Markers, size_px: tuple[int, int]) -> MarkerGrid | None:
    """Candidates in rows and columns, or None where fewer than six stand in a grid.

    Blocks are wider than high, so the longer step is taken along the rows; of two ways up the one nearer to the
    image's is taken. Where a whole row or column was not found, the grid is placed so that most of what is
    missing is outside the image.

    References
    ----------
    Hou, Kang & Qiao, Sensors 2025, 25(7), 2111, doi:10.3390/s25072111, section 2.1.
    """
    lattice = find_lattice(markers, SIDE, SIDE)
    if lattice is None:
        return None
    center = np.full((SIDE, SIDE, 2), np.nan)
    found = np.zeros((SIDE, SIDE), bool)
    radius = np.full((SIDE, SIDE), np.nan)
    confidence = np.zeros((SIDE, SIDE))
    column, row = lattice.cell.T
    center[row, column] = markers.center_px[lattice.index]
    found[row, column] = True
    radius[row, column] = markers.radius_px[lattice.index]
    confidence[row, column] = markers.confidence[lattice.index]
    grid = MarkerGrid(size_px, center, found, radius, confidence)
    return min(grid.placements(), key=_oddity)


def _oddity(grid: MarkerGrid) -> tuple[bool, bool, int, float]:
    """The less, the likelier this placement: steps, way up, missing inside the image, off the image's middle."""
    middle = (SIDE - 1) / 2
    model = projective(_cells(grid.found), grid.center_px[grid.found])
    ends = placed(model, middle + np.array([[0.5, 0], [-0.5, 0], [0, 0.5], [0, -0.5]]))
    along, across = ends[0] - ends[1], ends[2] - ends[3]
    margin = float(np.nanmedian(grid.radius_px))
    inside = ((grid.center_px > margin) & (grid.center_px < np.array(grid.size_px) - 1 - margin)).all(axis=-1)
    off = np.linalg.norm(placed(model, np.full(2, middle)) - np.array(grid.size_px) / 2)
    return (
        bool(np.linalg.norm(along) < np.linalg.norm(across)),
        bool(along[0] < 0),
        int((inside & ~grid.found).sum()),
        float(off),
    )


def _shifted(grid: MarkerGrid, down: int, right: int) -> MarkerGrid:
    """The found ones so many rows down and columns to the right; the others expected anew."""
    found = np.roll(grid.found, (down, right), axis=(0, 1))
    return _completed(
        MarkerGrid(
            grid.size_px,
            np.roll(grid.center_px, (down, right), axis=(0, 1)),
            found,
            np.where(found, np.roll(grid.radius_px, (down, right), axis=(0, 1)), np.nan),
            np.where(found, np.roll(grid.confidence, (down, right), axis=(0, 1)), 0.0),
        )
    )


def _cells(where: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(n, 2) column and row of the True entries, in the order of a boolean index."""
    return np.argwhere(where)[:, ::-1].astype(np.float64)


def _completed(grid: MarkerGrid) -> MarkerGrid:
    """Missing places from the fitted grid, plus how far the found ones of the same row and column stand off it."""
    found, missing = grid.found, ~grid.found
    if not missing.any():
        return grid
    known, wanted = _cells(found), _cells(missing)
    model = projective(known, grid.center_px[found])
    off = grid.center_px[found] - placed(model, known)
    away = np.abs(wanted[:, None] - known)
    weight = np.where((away == 0).any(axis=-1), 1.0 / away.sum(axis=-1) ** 2, 0.0)
    shift = (weight @ off) / np.maximum(weight.sum(axis=1, keepdims=True), 1.0)
    center = grid.center_px.copy()
    center[missing] = placed(model, wanted) + shift
    return replace(grid, center_px=center)
