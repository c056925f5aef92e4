"""Detection of the board's corners in one image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.chessboard import find_chessboard
from beltscape.calibration.detection.corners import Corners, has_planar_extent
from beltscape.calibration.detection.grey import convert_to_8_bit
from beltscape.calibration.detection.markers import find_aprilgrid, find_charuco
from beltscape.calibration.detection.subpixel import refine_corners
from beltscape.core.frames import Image, to_grey
from beltscape.target.board import MIN_CORNERS, Board, BoardSet
from beltscape.target.planar_boards import AprilGrid, CharucoBoard, Chessboard, PlanarBoard

Detector = Callable[[Image], Corners | None]


@dataclass(frozen=True, slots=True)
class PrintVariant:
    """Print variant of a board with markers."""

    legacy: bool = False
    inverted: bool = False

    def describe(self) -> str:
        """Return the variant as keys and values of board.toml."""
        return f"legacy = {str(self.legacy).lower()}, inverted = {str(self.inverted).lower()}"


DEFAULT_VARIANT = PrintVariant()


def make_detector(board: Board, variant: PrintVariant) -> Detector:
    """Return a function image → corners; its result is None if the board is not usable."""
    if isinstance(board, BoardSet):
        detectors = [make_detector(face.board, variant) for face in board.faces]
        return lambda image: _join_faces([detect(image) for detect in detectors], board.offsets)
    return lambda image: _detect_planar(board, image, variant)


def add_back_side(detect: Detector) -> Detector:
    """Return a detector that also finds boards with markers from behind: printed on both sides, or on glass.

    Their corners lie where those of the front do, and have the same ids.
    """

    def detect_either_side(image: Image) -> Corners | None:
        corners = detect(image)
        if corners is not None:
            return corners
        flipped = detect(np.ascontiguousarray(image[:, ::-1]))
        if flipped is None:
            return None
        pixels = np.column_stack([image.shape[1] - 1 - flipped.pixels[:, 0], flipped.pixels[:, 1]])
        return replace(flipped, pixels=pixels, from_behind=True)

    return detect_either_side


def _detect_planar(board: PlanarBoard, image: Image, variant: PrintVariant) -> Corners | None:
    light = convert_to_8_bit(image)
    if variant.inverted:
        light = 255 - light
    if isinstance(board, CharucoBoard):
        corners = find_charuco(light, board, legacy=variant.legacy)
    elif isinstance(board, AprilGrid):
        corners = find_aprilgrid(light, board)
    else:
        corners = find_chessboard(light, board.corners)
    if corners is None or len(corners) < MIN_CORNERS:
        return None
    unit_mm, gap = _measure_margins(board)
    luminance = -to_grey(image) if variant.inverted else to_grey(image)
    refined = refine_corners(luminance, corners, board.corners_mm()[corners.ids] / unit_mm, gap)
    return _reject_outliers(board, refined)


def _measure_margins(board: PlanarBoard) -> tuple[float, float]:
    """Return the length of a corner's edges, mm, and the share of it beside the edges that is empty."""
    if isinstance(board, CharucoBoard):
        return board.square_mm, (1 - board.marker_mm / board.square_mm) / 2
    if isinstance(board, Chessboard):
        return board.square_mm, 1.0
    return board.clear_share * board.tag_mm, 1.0


def _join_faces(faces: list[Corners | None], offsets: tuple[int, ...]) -> Corners | None:
    """Return the corners of all boards of a set, numbered through; None without any."""
    seen = [(corners, start) for corners, start in zip(faces, offsets, strict=False) if corners is not None]
    if not seen:
        return None
    return Corners(
        np.concatenate([corners.ids + start for corners, start in seen]),
        np.concatenate([corners.pixels for corners, _ in seen]),
    )


def _reject_outliers(board: PlanarBoard, corners: Corners) -> Corners | None:
    """Return the corners that a homography of the board explains, or None if they are too few."""
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
    return corners.select(inliers)
