"""Consistency of a view's corners: each is compared with the place that the board's other corners give it.

An object that covers a tag in part displaces its contour, and its corner may then be found at another crossing of
edges, a whole square off. Neighbouring corners tell, whatever the lens: over a few squares every image of a board is
smooth.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from beltscape.calibration.detection.corners import Corners, has_planar_extent
from beltscape.core.arrays import Array
from beltscape.target.board import MIN_CORNERS
from beltscape.target.planar_boards import PlanarBoard

NEIGHBOURS = 12
"""Corners about one that place it: two rings of a chessboard. Of six, three wrong ones of one tag are half."""
START_DISTORTIONS = 0.0, -0.25, -0.6
"""Distortions from which the fit starts, with half the image's diagonal as unit: none, a wide lens, a fisheye."""
DISTORTION_SIGMA = 0.3
"""Prior of the distortions (1 σ), in the same unit: it decides where few corners leave them open."""
ROUNDS = 10
"""Rounds of reweighting, and of the inversion of the distortion; chosen, not tuned."""
MIN_SCALE_PX = 0.05
"""Least scale of the weights, about the scatter of sharp corners: a perfect fit of some must not exclude others."""
SLOPE_DAMPING = 1e-3
"""Damping of the slopes of a local plane, over its weights: neighbours in a row leave one slope open."""
MAX_CONTRADICTION_PX, MAX_CONTRADICTION = 0.35, 7.0
"""A corner is left out if it lies farther from its place than this many px, and than this many robust standard
deviations of the view's corners, or of those about it. Of 1,500 simulated corners that are right none is, of
1,600 of a fisheye whose board fills the image 5 (2026-11-30)."""
RAYLEIGH_MEDIAN = 1.1774
"""Median length of a vector of two normal components, over their standard deviation: √(2 ln 2)."""


def reject_outliers(board: PlanarBoard, corners: Corners, size_px: tuple[int, int]) -> Corners | None:
    """Return the corners that the board's others confirm, or None if they are too few."""
    if len(corners) < MIN_CORNERS:
        return None
    on_board: NDArray[np.float64] = board.corners_mm()[corners.ids]
    if not has_planar_extent(on_board):
        return None
    tolerance = 0.03 * float(np.linalg.norm(np.ptp(corners.pixels, axis=0)))  # allows for lens distortion
    homography, inlier = cv2.findHomography(on_board, corners.pixels, cv2.RANSAC, tolerance)
    if homography is None or inlier is None:
        return None
    inliers = inlier.ravel().astype(bool)
    if inliers.sum() < max(MIN_CORNERS, 0.6 * len(corners)) or not has_planar_extent(on_board[inliers]):
        return None
    inliers[inliers] = find_consistent(on_board[inliers], corners.pixels[inliers], size_px)
    if inliers.sum() < MIN_CORNERS or not has_planar_extent(on_board[inliers]):
        return None
    return corners.select(inliers)


def find_consistent(on_board: Array, pixels: Array, size_px: tuple[int, int]) -> NDArray[np.bool_]:
    """Return whether each corner (n,) lies where the others place it, the worst left out first.

    Corners on the board (n, 2) or (n, 3) mm, in the image (n, 2) px.
    """
    kept = np.ones(len(pixels), bool)
    while kept.sum() >= MIN_CORNERS:
        with np.errstate(all="ignore"):
            found = _place(on_board[kept], pixels[kept], size_px, None)
        if found is None:
            break
        placed, spread = found
        off = np.linalg.norm(placed - pixels[kept], axis=1)
        scale = np.maximum(spread, np.median(off)) / RAYLEIGH_MEDIAN
        excess = off / np.maximum(MAX_CONTRADICTION_PX, MAX_CONTRADICTION * scale)
        wrong = excess > max(1.0, excess.max() / 2)
        if not wrong.any():
            break
        kept[np.flatnonzero(kept)[wrong]] = False
    return kept


def place_corners(
    on_board: Array, pixels: Array, size_px: tuple[int, int], targets: Array | None = None
) -> Array | None:
    """Return the places (m, 2) px of points on the board by the corners near them; None without a homography.

    Each corner's place by the others, or those of ``targets`` (m, 2) or (m, 3) mm. A homography and three radial
    distortions are fitted to all corners, a plane to what they leave at the nearest ones, both robustly.
    """
    with np.errstate(all="ignore"):  # points at the horizon of a wrong start
        found = _place(on_board, pixels, size_px, targets)
    return None if found is None else found[0]


def _place(
    on_board: Array, pixels: Array, size_px: tuple[int, int], targets: Array | None
) -> tuple[Array, Array] | None:
    """Return the places (m, 2), and the median distance (m,) of the neighbours from the plane that gives each, px."""
    itself, wanted = targets is None, on_board if targets is None else targets
    middle, half = on_board[:, :2].mean(axis=0), np.ptp(on_board[:, :2], axis=0).max() / 2
    known, asked = (on_board[:, :2] - middle) / half, (wanted[:, :2] - middle) / half
    center, radius = (np.array(size_px) - 1) / 2, float(np.hypot(*size_px)) / 2
    seen = (pixels - center) / radius
    model = _fit_model(known, seen, MIN_SCALE_PX / radius)
    if model is None:
        return None
    rest = seen - _distort(_map_points(model, known), model[8:])
    count = min(NEIGHBOURS, len(pixels) - 1)
    _, near = KDTree(known).query(asked, count + itself)
    near = near[:, 1:] if itself else near
    steps = known[near] - asked[:, None]
    steps = steps / np.abs(steps).max(axis=(1, 2), keepdims=True)
    design = np.concatenate([np.ones((*near.shape, 1)), steps], axis=2)
    planes, spread = _fit_planes(design, rest[near], MIN_SCALE_PX / radius)
    placed: Array = (_distort(_map_points(model, asked), model[8:]) + planes) * radius + center
    return placed, spread * radius


def _fit_model(known: Array, seen: Array, min_scale: float) -> Array | None:
    """Return a homography (8) and distortions (3): points (n, 2) of the board to undistorted ones of the image."""
    starts = [_start_model(known, seen, distortion) for distortion in START_DISTORTIONS]
    if not (found := [start for start in starts if start is not None]):
        return None

    def compute_misfit(start: Array) -> float:
        return float(np.median(np.linalg.norm(_linearise(start, known, seen)[0], axis=1)))

    model = min(found, key=compute_misfit)
    prior = np.zeros(11)
    prior[8:] = (min_scale / DISTORTION_SIGMA) ** 2
    for _ in range(ROUNDS):
        errors, derivatives = _linearise(model, known, seen)
        off = np.linalg.norm(errors, axis=1)
        weights = 1 / (1 + (off / max(float(np.median(off)), min_scale)) ** 2)
        weighted = derivatives * weights[:, None, None]
        normal = np.einsum("nkp,nkq->pq", weighted, derivatives) + np.diag(prior + 1e-12)
        model = model - np.linalg.solve(normal, np.einsum("nkp,nk->p", weighted, errors) + prior * model)
    return model


def _start_model(known: Array, seen: Array, distortion: float) -> Array | None:
    homography, _ = cv2.findHomography(known, _undistort(seen, np.array([distortion, 0.0, 0.0])), cv2.LMEDS)
    if homography is None or abs(homography[2, 2]) < 1e-9:
        return None
    return np.array([*(homography / homography[2, 2]).ravel()[:8], distortion, 0.0, 0.0])


def _linearise(model: Array, known: Array, seen: Array) -> tuple[Array, Array]:
    """Return errors (n, 2) in the undistorted image, and their derivatives (n, 2, 11) by the model."""
    one, zero = np.ones(len(known)), np.zeros((len(known), 3))
    points = np.column_stack([known, one])
    depth = (known @ model[6:8] + 1)[:, None]
    mapped = _map_points(model, known)
    squared = (seen**2).sum(axis=1)[:, None]
    undistorted = _undistort(seen, model[8:])
    powers = squared ** np.arange(1, 4)
    change = undistorted / (1 + powers @ model[8:])[:, None]
    derivatives = np.empty((len(known), 2, 11))
    derivatives[:, 0, :6] = np.column_stack([points, zero]) / depth
    derivatives[:, 1, :6] = np.column_stack([zero, points]) / depth
    derivatives[:, :, 6:8] = -mapped[:, :, None] * (known / depth)[:, None]
    derivatives[:, :, 8:] = change[:, :, None] * powers[:, None]
    return mapped - undistorted, derivatives


def _map_points(model: Array, points: Array) -> Array:
    mapped: Array = (points @ model[[0, 1, 3, 4]].reshape(2, 2).T + model[[2, 5]]) / (
        points @ model[6:8] + 1
    )[:, None]
    return mapped


def _undistort(seen: Array, distortion: Array) -> Array:
    """Return q / (1 + λ r² + μ r⁴ + ν r⁶), the division model (Fitzgibbon 2001, doi:10.1109/CVPR.2001.990465)."""
    squared = (seen**2).sum(axis=1, keepdims=True)
    undistorted: Array = seen / (1 + squared ** np.arange(1, 4) @ distortion)[:, None]
    return undistorted


def _distort(undistorted: Array, distortion: Array) -> Array:
    """Return the inverse of `_undistort` by Newton's method on the radius."""
    target = np.linalg.norm(undistorted, axis=1)
    radius = target.copy()
    for _ in range(ROUNDS):
        powers = radius[:, None] ** np.arange(2, 7, 2)
        divisor = 1 + powers @ distortion
        slope = 1 - target * (powers * np.arange(2, 7, 2) @ distortion) / np.maximum(radius, 1e-12)
        radius = np.clip(radius - (radius - target * divisor) / slope, 0, 2)
    scale: Array = undistorted * (radius / np.maximum(target, 1e-12))[:, None]
    return scale


def _fit_planes(design: Array, values: Array, min_scale: float) -> tuple[Array, Array]:
    """Return the values (b, 2) at the origin of planes that fit (b, n, 2) at (b, n, 3), each with Cauchy's weights.

    And the median distance (b,) of the values from their plane.
    """
    found, off = np.zeros((len(design), 3, 2)), np.zeros(values.shape[:2])
    weights = np.ones(values.shape[:2])
    for _ in range(ROUNDS):
        weighted = design * weights[..., None]
        normal = weighted.transpose(0, 2, 1) @ design
        normal += weights.sum(axis=1)[:, None, None] * np.diag([0.0, SLOPE_DAMPING, SLOPE_DAMPING])
        found = np.linalg.solve(normal, weighted.transpose(0, 2, 1) @ values)
        off = np.linalg.norm(values - design @ found, axis=2)
        scale = np.maximum(np.median(off, axis=1, keepdims=True), min_scale)
        weights = 1 / (1 + (off / scale) ** 2)
    return found[:, 0], np.median(off, axis=1)
