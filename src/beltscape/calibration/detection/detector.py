"""Detection of the board's corners in one image.

Plain chessboards are found to about a pixel by several detectors in turn, boards with markers (ChArUco and AprilGrid)
by these; then the corners are refined.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corner_consistency import place_corners, reject_outliers
from beltscape.calibration.detection.corners import Corners, has_planar_extent
from beltscape.calibration.detection.subpixel import refine_corners
from beltscape.core.arrays import Array
from beltscape.core.frames import Image, to_grey
from beltscape.target.board import MIN_CORNERS, Board, BoardSet
from beltscape.target.planar_boards import (
    AprilGrid,
    CharucoBoard,
    Chessboard,
    PlanarBoard,
    load_dictionary,
    load_markers,
)

Grid = tuple[int, int]
Grey = NDArray[np.uint8]

_SECTORS = {"sectors": cv2.CALIB_CB_EXHAUSTIVE, "sectors, equalised": cv2.CALIB_CB_NORMALIZE_IMAGE}
_SQUARES = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK


@dataclass(frozen=True, slots=True)
class Attempt:
    """One detector on the image, reduced to at most a share of its size and to a number of pixels."""

    detector: str
    """OpenCV's by squares (`findChessboardCorners`), or by sectors (`findChessboardCornersSB`), thorough or in
    equalised light."""
    share: float
    side_px: int

    def find(self, light: Grey, grid: Grid) -> NDArray[np.float32] | None:
        """Return the corners (n, 2) in the full image; None unless the whole grid is found."""
        scale = self.compute_scale(light)
        if scale < 1:
            light = cv2.resize(light, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        if self.detector == "squares":
            found, pixels = cv2.findChessboardCorners(light, grid, flags=_SQUARES)
        else:
            found, pixels = cv2.findChessboardCornersSB(light, grid, flags=_SECTORS[self.detector])
        return ((pixels.reshape(-1, 2) + 0.5) / scale - 0.5).astype(np.float32) if found else None

    def compute_scale(self, light: Grey) -> float:
        """Return the factor on the image's size."""
        return min(self.share, self.side_px / max(light.shape))


ATTEMPTS = (
    Attempt("squares", share=1.0, side_px=1000),
    Attempt("sectors", share=0.5, side_px=1000),
    Attempt("sectors, equalised", share=1.0, side_px=2000),
    Attempt("sectors", share=1.0, side_px=2000),
    Attempt("squares", share=1.0, side_px=2000),
)
"""Detectors in turn, by what each finds at what cost: docs/explanation/calibration.md has the table. Equalised light
hides some large boards and shows others. The detector by squares takes seconds at full size in clutter, so it comes
last."""


def find_chessboard(light: Grey, grid: Grid) -> Corners | None:
    """Detect the inner corners of a plain chessboard in a grey image (H, W) to about a pixel; None without it."""
    pixels = _detect_grid(light, grid)
    if pixels is None:
        return None
    spacing = np.linalg.norm(np.diff(pixels.reshape(grid[1], grid[0], 2), axis=1), axis=-1).min()
    half = int(np.clip(spacing / 3, 2, 11))  # the window must not reach the next corner
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
    pixels = cv2.cornerSubPix(light, pixels, (half, half), (-1, -1), criteria)
    ordered = _order_from_dark_end(light, _orient_rows(pixels.astype(np.float64), grid), grid)
    return Corners(np.arange(len(ordered), dtype=np.int64), ordered)


def _detect_grid(light: Grey, grid: Grid) -> NDArray[np.float32] | None:
    """Return the corners (n, 2) of the first attempt that finds the whole grid."""
    tried: set[tuple[str, float]] = set()
    for attempt in ATTEMPTS:
        step = attempt.detector, attempt.compute_scale(light)
        pixels = None if step in tried else attempt.find(light, grid)
        if pixels is not None:
            return pixels
        tried.add(step)
    return None


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


NEIGHBOURS = 6
"""Tags about one whose centres place its corners: five amplify the errors of contours, over more of them a fisheye
lens bends by several px."""
MIN_TAGS = 5
"""Least number of tags for such a local homography; fewer place their own corners."""
SEARCHES = 3
"""Searches of an AprilGrid's corners: the second and the third start at places that neighbouring corners give."""
MAX_DISAGREEMENT_PX = 1.0
"""Distance of a found corner from where its neighbours expect it, from which on it is searched again there."""
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
    return _sort_corners(pixels, ids)


def find_charuco_faces(
    light: NDArray[np.uint8], boards: Sequence[CharucoBoard], *, legacy: bool
) -> list[Corners | None]:
    """Detect the corners of several boards of one dictionary in a grey image (H, W), the markers of all at once."""
    most = max(max(board.marker_ids) for board in boards) + 1
    detector = _make_marker_detector(boards[0].dictionary, most)
    markers, ids, rejected = detector.detectMarkers(light)
    numbers = np.empty(0, np.int32) if ids is None else ids.ravel()
    found: list[Corners | None] = []
    for board in boards:
        own = np.flatnonzero(np.isin(numbers, board.marker_ids))
        if not own.size:
            found.append(None)
            continue
        refined, refined_ids, _, _ = detector.refineDetectedMarkers(
            light,
            board.to_opencv(legacy=legacy),
            [markers[k] for k in own.tolist()],
            numbers[own][:, None],
            rejected,
        )
        pixels, corner_ids, _, _ = _make_charuco_detector(board, legacy).detectBoard(
            light, markerCorners=refined, markerIds=refined_ids
        )
        found.append(_sort_corners(pixels, corner_ids))
    return found


@cache
def _make_marker_detector(dictionary: str, count: int) -> cv2.aruco.ArucoDetector:
    return cv2.aruco.ArucoDetector(load_markers(dictionary, count), _make_parameters())


def _sort_corners(pixels: Any, ids: Any) -> Corners | None:
    """Return what OpenCV detected, by id; None without corners."""
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
    for _ in range(SEARCHES - 1):
        pixels, placed = _search_again(light, placed, pixels, board.corners_mm()[ids_of_corners], board)
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
    searched, last = tags.copy(), np.array(light.shape[::-1]) - 1
    for i, (tag, edge_px) in enumerate(zip(tags, edges, strict=True)):
        if not ((tag >= 0) & (tag <= last)).all():  # the search refuses them
            continue
        half = int(np.clip(SEARCH_SHARE * board.clear_share * edge_px, 2, 11))
        inside = np.ascontiguousarray(tag[:, None], np.float32)
        searched[i] = cv2.cornerSubPix(light, inside, (half, half), (-1, -1), criteria)[:, 0]
    return searched.reshape(-1, 2)


def convert_to_8_bit(image: Image) -> NDArray[np.uint8]:
    """Return the luminance (H, W) uint8; 16-bit images are scaled by their own brightest values."""
    luminance = to_grey(image)
    if image.dtype == np.uint16:
        luminance = luminance * (255.0 / max(float(np.quantile(luminance, 0.999)), 1.0))
    return np.clip(np.rint(luminance), 0, 255).astype(np.uint8)


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
        faces = [face.board for face in board.faces]
        if charuco := _list_alike(faces):
            return lambda image: _join_faces(_detect_faces(charuco, image, variant), board.offsets)
        detectors = [make_detector(face, variant) for face in faces]
        return lambda image: _join_faces([detect(image) for detect in detectors], board.offsets)
    return lambda image: _detect_planar(board, image, variant)


def _list_alike(boards: Sequence[PlanarBoard]) -> list[CharucoBoard]:
    """Return ChArUco boards that all have markers of one dictionary; empty for others."""
    charuco = [board for board in boards if isinstance(board, CharucoBoard)]
    is_alike = len(charuco) == len(boards) and len({board.dictionary for board in charuco}) == 1
    return charuco if is_alike else []


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
    light = _make_light(image, variant)
    if isinstance(board, CharucoBoard):
        corners = find_charuco(light, board, legacy=variant.legacy)
    elif isinstance(board, AprilGrid):
        corners = find_aprilgrid(light, board)
    else:
        corners = find_chessboard(light, board.corners)
    return _refine_planar(board, image, corners, variant)


def _detect_faces(
    boards: Sequence[CharucoBoard], image: Image, variant: PrintVariant
) -> list[Corners | None]:
    """Return the corners of each board of one dictionary; None for those that are not usable."""
    found = find_charuco_faces(_make_light(image, variant), boards, legacy=variant.legacy)
    return [
        _refine_planar(board, image, corners, variant) for board, corners in zip(boards, found, strict=True)
    ]


def _search_again(
    light: NDArray[np.uint8], placed: Array, searched: Array, on_board: Array, board: AprilGrid
) -> tuple[Array, Array]:
    """Return corners (4n, 2) searched again where none was found or its neighbours contradict it, and their places.

    Tags' centres place corners of a strongly curved image, as of a fisheye lens, some px off, and those beside a tag
    that something covers in part by more; corners found do not.
    """
    is_found = (searched != placed).any(axis=1)
    if is_found.sum() < MIN_CORNERS or not has_planar_extent(on_board[is_found]):
        return searched, placed
    size_px = (light.shape[1], light.shape[0])
    expected = place_corners(on_board[is_found], searched[is_found], size_px)
    if expected is None:
        return searched, placed
    again = searched.copy()
    is_off = np.linalg.norm(expected - searched[is_found], axis=1) > MAX_DISAGREEMENT_PX
    again[is_found] = np.where(is_off[:, None], expected, searched[is_found])
    if not is_found.all():
        unseen = place_corners(on_board[is_found], searched[is_found], size_px, on_board[~is_found])
        again[~is_found] = searched[~is_found] if unseen is None else unseen
    again = np.where(np.isfinite(again), again, searched)
    is_kept = (again == searched).all(axis=1)[:, None]
    if is_kept.all():
        return searched, placed
    repeated = _search_corners(light, again, board)
    return np.where(is_kept, searched, repeated), np.where(is_kept, placed, again)


def _make_light(image: Image, variant: PrintVariant) -> Grey:
    """Return the luminance (H, W) uint8 as if the print were not inverted."""
    light = convert_to_8_bit(image)
    return 255 - light if variant.inverted else light


def _refine_planar(
    board: PlanarBoard, image: Image, corners: Corners | None, variant: PrintVariant
) -> Corners | None:
    """Return detected corners refined, without outliers; None if they are too few."""
    if corners is None or len(corners) < MIN_CORNERS:
        return None
    unit_mm, gap = _measure_margins(board)
    luminance = -to_grey(image) if variant.inverted else to_grey(image)
    refined = refine_corners(luminance, corners, board.corners_mm()[corners.ids] / unit_mm, gap)
    return reject_outliers(board, refined, (luminance.shape[1], luminance.shape[0]))


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
