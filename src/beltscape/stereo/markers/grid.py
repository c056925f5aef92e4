"""The 4×4 grid of the pattern's markers in one image: their numbering, and the positions of hidden ones.

The grids of a rig's cameras get a common numbering; the regions of the pattern divide the image half way between
neighbouring markers (the paper's Section 2.1).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import Image
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.rig import Rig
from beltscape.kernels import Kernels, load_on_processor
from beltscape.stereo.markers.detection import MarkerDetections, detect_markers
from beltscape.stereo.markers.lattice import apply_homography, find_lattice, fit_homography
from beltscape.stereo.multiview.depth_range import compute_search_range

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


def compute_region_corners(center_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (9, 9, 2) lattice of the regions' corners (even, even), boundary midpoints and markers (odd, odd).

    The boundary passes through the mean of two neighbouring markers, corners are the mean of four; the outer
    boundary lies half a step beyond the outermost markers.
    """
    padded = np.pad(center_px, ((1, 1), (1, 1), (0, 0)))
    padded[0], padded[-1] = 2 * padded[1] - padded[2], 2 * padded[-2] - padded[-3]
    padded[:, 0], padded[:, -1] = 2 * padded[:, 1] - padded[:, 2], 2 * padded[:, -2] - padded[:, -3]
    lattice = np.empty((2 * SIDE + 1, 2 * SIDE + 1, 2))
    lattice[1::2, 1::2] = center_px
    lattice[0::2, 1::2] = (padded[:-1, 1:-1] + padded[1:, 1:-1]) / 2
    lattice[1::2, 0::2] = (padded[1:-1, :-1] + padded[1:-1, 1:]) / 2
    lattice[0::2, 0::2] = (padded[:-1, :-1] + padded[1:, :-1] + padded[:-1, 1:] + padded[1:, 1:]) / 4
    return lattice


def compute_region_outline(center_px: NDArray[np.float64], row: int, column: int) -> NDArray[np.float64]:
    """Return the (8, 2) outline of one region, u, v."""
    lattice = compute_region_corners(center_px)
    around = [(0, 0), (0, 1), (0, 2), (1, 2), (2, 2), (2, 1), (2, 0), (1, 0)]
    return np.array([lattice[2 * row + r, 2 * column + c] for r, c in around])


_MAX_ERROR_RADII = 0.3
"""Largest reprojection error of a marker, in its radii; hiding half of a disc shifts its centroid by 0.42."""
_MAX_ERROR_PX = 2.0
"""Largest reprojection error of small markers, px: the accuracy of rig and centroid."""
_MIN_CONSISTENT, _MIN_CONSISTENT_SHARE = 4, 0.7
"""Least number of consistent markers of an accepted numbering, and their share of the common ones; four of five by
chance are rarer than one in a thousand."""


def align_grids(grids: Mapping[str, MarkerGrid], rig: Rig) -> dict[str, MarkerGrid]:
    """Return the grids with the rows and columns of the camera with the most markers; among equals, of the core.

    Every other grid is turned (0, 90, 180, 270°) and, where whole rows or columns are missing, shifted so that the
    rays of most markers intersect; a grid in which hardly any do is left out.
    """
    if not grids:
        return {}
    kernels = load_on_processor()
    reference = max(grids, key=lambda name: (grids[name].count, name == rig.core))
    aligned = {reference: grids[reference]}
    for name in grids:
        if name == reference:
            continue
        best, best_score = None, (0, 0.0)
        for option in grids[name].list_numberings():
            count, error, common = _compare_pair({reference: grids[reference], name: option}, rig, kernels)
            if count >= max(_MIN_CONSISTENT, _MIN_CONSISTENT_SHARE * common) and (count, -error) > best_score:
                best, best_score = option, (count, -error)
        if best is not None:
            aligned[name] = best
    return {name: aligned[name] for name in grids if name in aligned}


def _compare_pair(grids: Mapping[str, MarkerGrid], rig: Rig, kernels: Kernels) -> tuple[int, float, int]:
    """Return how many markers of two cameras are consistent, their mean error (px), and how many are common."""
    names = list(grids)
    pixels = np.stack([_undistort_centers(grids[name], rig, name) for name in names])
    points = kernels.triangulate(np.stack([rig.projection(name) for name in names]), pixels)
    error = _reprojection_errors_px(points, pixels, rig, names)
    limit = np.stack([_max_error_px(grids[name]) for name in names])
    near, far = compute_search_range(rig, rig.auxiliaries)
    consistent = (error < limit).all(axis=0) & (points[:, 2] > near) & (points[:, 2] < far)
    common = int(np.isfinite(pixels).all(axis=(0, 2)).sum())
    return int(consistent.sum()), float(error[:, consistent].mean()) if consistent.any() else np.inf, common


def _undistort_centers(grid: MarkerGrid, rig: Rig, name: str) -> NDArray[np.float64]:
    """Return the (16, 2) undistorted pixels; NaN where not detected."""
    camera = rig.cameras[name]
    pixels = camera.undistort(grid.center_px.reshape(-1, 2)) * camera.focal_px + camera.center_px
    pixels[~grid.detected.reshape(-1)] = np.nan
    return pixels


def _max_error_px(grid: MarkerGrid) -> NDArray[np.float64]:
    """Return the (16,) largest accepted reprojection error of each marker."""
    typical = float(np.nanmedian(grid.radius_px))
    return np.full(SIDE * SIDE, max(_MAX_ERROR_PX, _MAX_ERROR_RADII * typical))


def _reprojection_errors_px(
    points_mm: NDArray[np.float64], pixels: NDArray[np.float64], rig: Rig, names: list[str]
) -> NDArray[np.float64]:
    """Return the (n, N) distance of undistorted pixels from the projected points; inf behind a camera."""
    errors: list[NDArray[np.float64]] = []
    for name, measured in zip(names, pixels, strict=True):
        local = rig.cam_from_core[name].apply(points_mm)
        camera = rig.cameras[name]
        with np.errstate(divide="ignore", invalid="ignore"):
            expected = local[:, :2] / local[:, 2:] * camera.focal_px + camera.center_px
        distance = np.linalg.norm(expected - measured, axis=-1)
        errors.append(np.where(local[:, 2] > 0, distance, np.where(np.isfinite(distance), np.inf, np.nan)))
    return np.array(errors)
