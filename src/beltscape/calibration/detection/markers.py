"""Detection of boards with markers, ChArUco and AprilGrid, to about a pixel."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import Corners, has_planar_extent
from beltscape.target.planar_boards import AprilGrid, CharucoBoard, load_dictionary

Array = NDArray[np.float64]

NEIGHBOURS = 12
"""Tags about one whose centres place its corners: a lens bends less over these than a contour errs."""
MIN_TAGS = 5
"""Least number of tags for such a local homography; fewer place their own corners."""
SEARCH_SHARE = 0.35
"""Half of the window in which a tag's corner is searched, over its distance from other edges; at 0.5 the windows
reach the neighbouring corners of tilted tags."""


@cache
def _make_charuco_detector(board: CharucoBoard, legacy: bool) -> cv2.aruco.CharucoDetector:
    charuco = cv2.aruco.CharucoParameters()
    charuco.tryRefineMarkers = True
    return cv2.aruco.CharucoDetector(board.to_opencv(legacy=legacy), charuco, _make_parameters())


def _make_parameters() -> cv2.aruco.DetectorParameters:
    markers = cv2.aruco.DetectorParameters()
    markers.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    return markers


def find_charuco(light: NDArray[np.uint8], board: CharucoBoard, *, legacy: bool) -> Corners | None:
    """Detect the corners of a ChArUco board in a grey image (H, W); None without any."""
    pixels, ids, _, _ = _make_charuco_detector(board, legacy).detectBoard(light)
    if pixels is None or ids is None or len(ids) == 0:
        return None
    order = np.argsort(ids.ravel(), kind="stable")
    return Corners(ids.ravel()[order].astype(np.int64), pixels.reshape(-1, 2)[order].astype(np.float64))


@cache
def _make_tag_detector(dictionary: str, border_bits: int) -> cv2.aruco.ArucoDetector:
    parameters = _make_parameters()
    parameters.markerBorderBits = border_bits
    return cv2.aruco.ArucoDetector(load_dictionary(dictionary), parameters)


def find_aprilgrid(light: NDArray[np.uint8], board: AprilGrid) -> Corners | None:
    """Detect the tags' corners of an AprilGrid in a grey image (H, W); None without any.

    The squares at a tag's corners touch its contour, so that the detected corners lie several pixels off. They are
    placed by the centres of the neighbouring tags, and then searched as crossings of edges.
    """
    found, ids, _ = _make_tag_detector(board.dictionary, board.border_bits).detectMarkers(light)
    if ids is None:
        return None
    numbers = ids.ravel().astype(np.int64) - board.first_id
    known = (numbers >= 0) & (numbers < len(board.marker_ids))
    numbers, contours = numbers[known], np.array(found, np.float64).reshape(-1, 4, 2)[known]
    numbers, first = np.unique(numbers, return_index=True)
    if len(numbers) < 2:
        return None
    corners = board.tag_corners()[numbers]
    contours = _turn_tags(contours[first], board.corners_mm()[corners])
    placed = _place_corners(contours, board.corners_mm()[corners])
    ids_of_corners = corners.ravel()
    pixels = _search_corners(light, placed, board)
    order = np.argsort(ids_of_corners, kind="stable")
    return Corners(ids_of_corners[order], pixels[order])


def _turn_tags(contours: Array, tags_mm: Array) -> Array:
    """Return contours (n, 4, 2) from each tag's top left corner on, whichever corner the dictionary starts with."""

    def compute_misfit(turns: int) -> float:
        turned = np.roll(contours, turns, axis=1).reshape(-1, 2)
        homography, _ = cv2.findHomography(tags_mm.reshape(-1, 2), turned)
        if homography is None:
            return np.inf
        mapped = cv2.perspectiveTransform(tags_mm.reshape(-1, 1, 2), homography).reshape(-1, 2)
        return float(np.median(np.linalg.norm(mapped - turned, axis=1)))

    return np.roll(contours, min(range(4), key=compute_misfit), axis=1)


def _place_corners(contours: Array, tags_mm: Array) -> Array:
    """Return the corners (4n, 2) as homographies of the neighbouring tags' centres place them."""
    centers, centers_mm = _intersect_diagonals(contours), tags_mm.mean(axis=1)
    placed = contours.copy()
    for i, tag in enumerate(tags_mm):
        near = np.argsort(np.linalg.norm(centers_mm - centers_mm[i], axis=1), kind="stable")[:NEIGHBOURS]
        if len(near) < MIN_TAGS or not has_planar_extent(centers_mm[near]):
            continue
        homography, _ = cv2.findHomography(centers_mm[near], centers[near])
        if homography is not None:
            placed[i] = cv2.perspectiveTransform(tag[:, None], homography)[:, 0]
    return placed.reshape(-1, 2)


def _intersect_diagonals(quads: Array) -> Array:
    """Return the intersections (n, 2) of the diagonals of quadrilaterals (n, 4, 2): the images of their centres."""
    points = np.concatenate([quads, np.ones((*quads.shape[:2], 1))], axis=2)
    crossing = np.cross(np.cross(points[:, 0], points[:, 2]), np.cross(points[:, 1], points[:, 3]))
    return crossing[:, :2] / crossing[:, 2:]


def _search_corners(light: NDArray[np.uint8], pixels: Array, board: AprilGrid) -> Array:
    """Return the crossings of edges (4n, 2) next to the placed corners of each tag."""
    tags = pixels.reshape(-1, 4, 2)
    edges = np.linalg.norm(tags - np.roll(tags, 1, axis=1), axis=2).min(axis=1)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)
    searched = np.empty_like(tags)
    for i, (tag, edge_px) in enumerate(zip(tags, edges, strict=True)):
        half = int(np.clip(SEARCH_SHARE * board.clear_share * edge_px, 2, 11))
        inside = np.ascontiguousarray(tag[:, None], np.float32)
        searched[i] = cv2.cornerSubPix(light, inside, (half, half), (-1, -1), criteria)[:, 0]
    return searched.reshape(-1, 2)
