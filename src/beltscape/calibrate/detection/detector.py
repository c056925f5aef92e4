"""Detection of the board's corners in one image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.calibrate.detection.corners import Corners, has_planar_extent
from beltscape.calibrate.detection.subpixel import refine_corners
from beltscape.core.frames import Image, to_grey
from beltscape.target.board import MIN_CORNERS, Board, CharucoBoard, Chessboard, corner_points_mm

Detector = Callable[[Image], Corners | None]


@dataclass(frozen=True, slots=True)
class PrintVariant:
    """Print variant of a ChArUco board."""

    legacy: bool = False
    inverted: bool = False

    def describe(self) -> str:
        """Return the variant as keys and values of board.toml."""
        return f"legacy = {str(self.legacy).lower()}, inverted = {str(self.inverted).lower()}"


DEFAULT_VARIANT = PrintVariant()


def make_detector(board: Board, variant: PrintVariant) -> Detector:
    """Return a function image → corners; its result is None if the board is not usable."""
    if isinstance(board, Chessboard):
        return lambda image: _reject_outliers(
            board, _refine(board, image, find_chessboard(image, board.corners))
        )
    return lambda image: _reject_outliers(
        board, _refine(board, image, _find_charuco(image, board, variant), variant)
    )


def _refine(
    board: Board, image: Image, corners: Corners | None, variant: PrintVariant = DEFAULT_VARIANT
) -> Corners | None:
    if corners is None or len(corners) < MIN_CORNERS:
        return None
    gap = (1 - board.marker_mm / board.square_mm) / 2 if isinstance(board, CharucoBoard) else 1.0
    luminance = -to_grey(image) if variant.inverted else to_grey(image)
    squares = corner_points_mm(board)[corners.ids, :2] / board.square_mm
    return refine_corners(luminance, corners, squares, gap)


def convert_to_8_bit(image: Image) -> NDArray[np.uint8]:
    """Return the luminance (H, W) uint8; 16-bit images are scaled by their own brightest values."""
    luminance = to_grey(image)
    if image.dtype == np.uint16:
        luminance = luminance * (255.0 / max(float(np.quantile(luminance, 0.999)), 1.0))
    return np.clip(np.rint(luminance), 0, 255).astype(np.uint8)


@cache
def _charuco_detector(board: CharucoBoard, legacy: bool) -> cv2.aruco.CharucoDetector:
    charuco = cv2.aruco.CharucoParameters()
    charuco.tryRefineMarkers = True
    markers = cv2.aruco.DetectorParameters()
    markers.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    return cv2.aruco.CharucoDetector(board.to_opencv(legacy=legacy), charuco, markers)


def _find_charuco(image: Image, board: CharucoBoard, variant: PrintVariant) -> Corners | None:
    light = convert_to_8_bit(image)
    if variant.inverted:
        light = 255 - light
    pixels, ids, _, _ = _charuco_detector(board, variant.legacy).detectBoard(light)
    if pixels is None or ids is None or len(ids) == 0:
        return None
    order = np.argsort(ids.ravel(), kind="stable")
    return Corners(ids.ravel()[order].astype(np.int64), pixels.reshape(-1, 2)[order].astype(np.float64))


def find_chessboard(image: Image, grid: tuple[int, int]) -> Corners | None:
    """Detect the inner corners of a plain chessboard to about a pixel, with two detectors in turn."""
    image = convert_to_8_bit(image)
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, pixels = cv2.findChessboardCorners(image, grid, flags=flags | cv2.CALIB_CB_FAST_CHECK)
    if not found:
        found, pixels = cv2.findChessboardCornersSB(image, grid, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not found:
        found, pixels = cv2.findChessboardCorners(image, grid, flags=flags)
    if not found:
        return None
    pixels = pixels.reshape(-1, 2).astype(np.float32)
    spacing = np.linalg.norm(np.diff(pixels.reshape(grid[1], grid[0], 2), axis=1), axis=-1).min()
    half = int(np.clip(spacing / 3, 2, 11))  # the window must not reach the next corner
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
    pixels = cv2.cornerSubPix(image, pixels, (half, half), (-1, -1), criteria)
    ordered = _order_from_dark_end(image, _orient_rows(pixels.astype(np.float64), grid), grid)
    return Corners(np.arange(len(ordered), dtype=np.int64), ordered)


def _orient_rows(pixels: NDArray[np.float64], grid: tuple[int, int]) -> NDArray[np.float64]:
    """Return the corners ordered for the board's front: from columns to rows is clockwise in the image."""
    corners = pixels.reshape(grid[1], grid[0], 2)
    across, down = corners[0, -1] - corners[0, 0], corners[-1, 0] - corners[0, 0]
    mirrored = across[0] * down[1] - across[1] * down[0] < 0
    return (corners[:, ::-1] if mirrored else corners).reshape(-1, 2)


def _order_from_dark_end(
    image: NDArray[np.uint8], pixels: NDArray[np.float64], grid: tuple[int, int]
) -> NDArray[np.float64]:
    """Return the corners ordered from the end whose first inner square is dark, which is the same in every camera.

    A board whose sides are both even or both odd looks the same upside down; its order is unchanged.
    """
    columns, rows = grid
    if (columns + rows) % 2 == 0:
        return pixels
    corners = pixels.reshape(rows, columns, 2)
    squares = (corners[:-1, :-1] + corners[1:, 1:] + corners[:-1, 1:] + corners[1:, :-1]) / 4
    u, v = np.rint(squares).astype(int).clip(0, np.array(image.shape[::-1]) - 1).transpose(2, 0, 1)
    values = image[v, u].astype(np.float64)
    parity = np.indices(values.shape).sum(axis=0) % 2
    return pixels if values[parity == 0].mean() < values[parity == 1].mean() else pixels[::-1].copy()


def _reject_outliers(board: Board, corners: Corners | None) -> Corners | None:
    """Return the corners that a homography of the board explains, or None if they are too few."""
    if corners is None or len(corners) < MIN_CORNERS:
        return None
    on_board = corner_points_mm(board)[corners.ids, :2]
    if not has_planar_extent(on_board):
        return None
    tolerance = 0.03 * float(np.linalg.norm(np.ptp(corners.pixels, axis=0)))  # allows for lens distortion
    homography, inlier = cv2.findHomography(on_board, corners.pixels, cv2.RANSAC, tolerance)
    if homography is None or inlier is None:
        return None
    inliers = inlier.ravel().astype(bool)
    if inliers.sum() < max(MIN_CORNERS, 0.6 * len(corners)) or not has_planar_extent(on_board[inliers]):
        return None
    return corners.select(inliers)
