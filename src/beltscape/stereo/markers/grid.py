"""The 4×4 grid of the pattern's markers in one image: their numbering, and the positions of hidden ones."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import Image
from beltscape.core.geometry.camera import Camera
from beltscape.stereo.markers.detection import MarkerDetections, detect_markers
from beltscape.stereo.markers.lattice import apply_homography, find_lattice, fit_homography

SIDE = 4
"""Markers per side: blocks of the pattern (the paper's Eq. 6)."""


@dataclass(frozen=True, slots=True, eq=False)
class MarkerGrid:
    """The pattern's markers in one image; row and column are those of the pattern up to quarter turns.

    One image does not determine the turn; `align_grids` gives all cameras of a rig the same rows and columns.
    """

    size_px: tuple[int, int]
    """(width, height) of the image."""
    center_px: NDArray[np.float64]
    """(4, 4, 2) u, v by row and column; for a marker that was not detected, predicted from the others."""
    detected: NDArray[np.bool_]
    """(4, 4) bool: detected; elsewhere predicted."""
    radius_px: NDArray[np.float64]
    """(4, 4) radius of the circle with the visible area; NaN where not detected."""
    confidence: NDArray[np.float64]
    """(4, 4) 0..1; 0 where not detected."""

    @property
    def count(self) -> int:
        """Number of detected markers."""
        return int(self.detected.sum())

    def undistort(self, camera: Camera) -> MarkerGrid:
        """Return the grid on the camera's undistorted grid; markers outside the lens model are predicted."""
        pixels = camera.undistort(self.center_px) * camera.focal_px + camera.center_px
        detected = self.detected & np.isfinite(pixels).all(axis=-1)
        grid = replace(self, center_px=np.where(detected[..., None], pixels, np.nan), detected=detected)
        return _predict_missing(grid) if detected.sum() >= 3 else replace(self, detected=detected)

    def list_numberings(self) -> list[MarkerGrid]:
        """Return the grid in every possible numbering: four turns, and all shifts that missing markers allow."""
        options: list[MarkerGrid] = []
        for turn in range(4):
            turned = MarkerGrid(
                self.size_px,
                np.rot90(self.center_px, turn, axes=(0, 1)),
                np.rot90(self.detected, turn, axes=(0, 1)),
                np.rot90(self.radius_px, turn, axes=(0, 1)),
                np.rot90(self.confidence, turn, axes=(0, 1)),
            )
            rows, columns = (np.flatnonzero(turned.detected.any(axis=k)) for k in (1, 0))
            for down in range(-int(rows[0]), SIDE - int(rows[-1])):
                for right in range(-int(columns[0]), SIDE - int(columns[-1])):
                    options.append(_shift_cells(turned, down, right))
        return options


def detect_marker_grid(image: Image) -> MarkerGrid | None:
    """Return the markers of an image (H, W) or (H, W, 3) in rows and columns; None without a grid."""
    height, width = image.shape[:2]
    return arrange_in_grid(detect_markers(image), (width, height))


def arrange_in_grid(markers: MarkerDetections, size_px: tuple[int, int]) -> MarkerGrid | None:
    """Return the detections in rows and columns; None where fewer than six form a grid.

    Blocks are wider than high, so the longer step is that along the rows; of the two orientations left, the one
    closer to the image's is taken. Where a whole row or column was not detected, the grid is placed so that most
    missing markers are outside the image.

    References
    ----------
    Hou, Kang & Qiao, Sensors 2025, 25(7), 2111, doi:10.3390/s25072111, section 2.1.
    """
    lattice = find_lattice(markers, SIDE, SIDE)
    if lattice is None:
        return None
    center = np.full((SIDE, SIDE, 2), np.nan)
    detected = np.zeros((SIDE, SIDE), bool)
    radius = np.full((SIDE, SIDE), np.nan)
    confidence = np.zeros((SIDE, SIDE))
    column, row = lattice.cell.T
    center[row, column] = markers.center_px[lattice.index]
    detected[row, column] = True
    radius[row, column] = markers.radius_px[lattice.index]
    confidence[row, column] = markers.confidence[lattice.index]
    grid = MarkerGrid(size_px, center, detected, radius, confidence)
    return min(grid.list_numberings(), key=_numbering_cost)


def _numbering_cost(grid: MarkerGrid) -> tuple[bool, bool, int, float]:
    """Return the cost of a numbering: steps, orientation, missing markers in the image, distance from its centre."""
    middle = (SIDE - 1) / 2
    model = fit_homography(_list_cells(grid.detected), grid.center_px[grid.detected])
    ends = apply_homography(model, middle + np.array([[0.5, 0], [-0.5, 0], [0, 0.5], [0, -0.5]]))
    along, across = ends[0] - ends[1], ends[2] - ends[3]
    margin = float(np.nanmedian(grid.radius_px))
    inside = ((grid.center_px > margin) & (grid.center_px < np.array(grid.size_px) - 1 - margin)).all(axis=-1)
    off = np.linalg.norm(apply_homography(model, np.full(2, middle)) - np.array(grid.size_px) / 2)
    return (
        bool(np.linalg.norm(along) < np.linalg.norm(across)),
        bool(along[0] < 0),
        int((inside & ~grid.detected).sum()),
        float(off),
    )


def _shift_cells(grid: MarkerGrid, down: int, right: int) -> MarkerGrid:
    """Return the grid with detected markers shifted by rows and columns, and the others predicted anew."""
    detected = np.roll(grid.detected, (down, right), axis=(0, 1))
    return _predict_missing(
        MarkerGrid(
            grid.size_px,
            np.roll(grid.center_px, (down, right), axis=(0, 1)),
            detected,
            np.where(detected, np.roll(grid.radius_px, (down, right), axis=(0, 1)), np.nan),
            np.where(detected, np.roll(grid.confidence, (down, right), axis=(0, 1)), 0.0),
        )
    )


def _list_cells(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the (n, 2) column and row of the True entries, in the order of a boolean index."""
    return np.argwhere(mask)[:, ::-1].astype(np.float64)


def _predict_missing(grid: MarkerGrid) -> MarkerGrid:
    """Return the grid with missing markers predicted: the homography plus the deviations of their row and column."""
    detected, missing = grid.detected, ~grid.detected
    if not missing.any():
        return grid
    known, unknown = _list_cells(detected), _list_cells(missing)
    model = fit_homography(known, grid.center_px[detected])
    deviation = grid.center_px[detected] - apply_homography(model, known)
    distance = np.abs(unknown[:, None] - known)
    weight = np.where((distance == 0).any(axis=-1), 1.0 / distance.sum(axis=-1) ** 2, 0.0)
    shift = (weight @ deviation) / np.maximum(weight.sum(axis=1, keepdims=True), 1.0)
    center = grid.center_px.copy()
    center[missing] = apply_homography(model, unknown) + shift
    return replace(grid, center_px=center)
