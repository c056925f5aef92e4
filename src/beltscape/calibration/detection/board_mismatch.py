"""Description of the board that images show if it is not the described one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.target.board import Board, Chessboard

_FAMILIES = ("DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL")
_SIZES = (50, 100, 250, 1000)
"""Numbers of markers in OpenCV's predefined dictionaries."""
_FIRST_MARKERS = {family: family.replace("_1000", "_50") for family in _FAMILIES if family.endswith("_1000")}
"""Dictionaries of the first markers of a family, which most boards have; they are searched twenty times as fast."""

_FEWEST = 6
"""Fewest markers that are taken for a board's; fewer can be chance."""
_LEAD = 3
"""Ratio of a dictionary's markers to those of the next one from which on only this one is searched: by chance, images
of boards show less than a tenth of their markers in another dictionary."""

Markers = list[tuple[NDArray[np.int64], NDArray[np.float64]]]
"""One (ids (n,), centres (n, 2) px) per image."""
Family = tuple[str, bool]
"""The largest dictionary of a family, and whether its markers are inverted."""


def describe_shown_board(images: Iterable[NDArray[np.uint8]], board: Board) -> str | None:
    """Describe the board that images (H, W) uint8 show, as far as it can be determined; None without any board."""
    images = list(images)
    markers, family, is_inverted = _find_family(images)
    if _count_markers(markers) >= _FEWEST:
        low, top = (int(limit(limit(ids) for ids, _ in markers)) for limit in (min, max))
        shifted = [(ids - low, centers) for ids, centers in markers]
        columns = _estimate_columns(markers) or _estimate_columns(shifted)
        # two rows hold as many markers as a row has squares; the first ones are rarely hidden in every image
        begins_later = columns is not None and low >= columns
        numbers = f"{low} to {top} (first_id = {low})" if begins_later else f"up to {top}"
        squares = f" on a board of {columns} columns" if columns else ""
        note = ", inverted" if is_inverted else ""
        return f"markers {_name_dictionary(family, top)} with ids {numbers}{squares}{note}"
    grid = _find_chessboard_grid(images)
    if grid and not (isinstance(board, Chessboard) and grid in (board.corners, board.corners[::-1])):
        return f"a chessboard of {grid[0]}×{grid[1]} inner corners"
    return None


def _find_family(images: list[NDArray[np.uint8]]) -> tuple[Markers, str, bool]:
    """Return the markers of the dictionary that most of them belong to, its name, and whether they are inverted.

    An image is searched for those of all dictionaries only until one is clearly ahead, first among their first
    markers.
    """
    found: dict[Family, Markers] = {
        (family, is_inverted): [] for family in _FAMILIES for is_inverted in (False, True)
    }
    searched = list(found)
    for image in images:
        views = {False: image, True: cv2.bitwise_not(image)}
        if len(searched) > 1:
            first = {
                (family, is_inverted): _detect_markers(views[is_inverted], _FIRST_MARKERS[family])
                for family, is_inverted in searched
                if family in _FIRST_MARKERS
            }
            searched = _find_leader(first) or searched
        for family, is_inverted in searched:
            found[family, is_inverted] += _detect_markers(views[is_inverted], family)
        searched = _find_leader(found) or searched
    family, is_inverted = max(found, key=lambda each: _count_markers(found[each]))
    return found[family, is_inverted], family, is_inverted


def _find_leader(found: dict[Family, Markers]) -> list[Family]:
    """Return the only dictionary that is clearly ahead of all others; empty without any."""
    ranking = sorted(found, key=lambda each: _count_markers(found[each]), reverse=True)
    most, second = (_count_markers(found[each]) for each in ranking[:2])
    return ranking[:1] if most >= _FEWEST and most > _LEAD * second else []


def _count_markers(markers: Markers) -> int:
    return sum(len(ids) for ids, _ in markers)


def _detect_markers(image: NDArray[np.uint8], family: str) -> Markers:
    """Return the markers of one image; none where there are fewer than three, which may be chance."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, family))
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(image)
    if ids is None or len(ids) < 3:
        return []
    return [(ids.ravel().astype(np.int64), np.array(corners).reshape(-1, 4, 2).mean(axis=1))]


def _name_dictionary(family: str, top: int) -> str:
    """Return the name of the family's smallest dictionary that contains the id ``top``."""
    if not family.endswith("_1000"):
        return family
    size = next(size for size in _SIZES if top < size)
    return family.removesuffix("1000") + str(size)


def _estimate_columns(markers: Markers) -> int | None:
    """Estimate the squares in a ChArUco row: the number for which the markers form a plane grid."""
    votes: Counter[int] = Counter()
    for ids, centers in markers:
        if len(ids) >= 6:
            fits = {columns: _compute_misfit(ids, centers, columns) for columns in range(3, 31)}
            best = min(fits, key=lambda columns: fits[columns])
            if fits[best] < 0.25:
                votes[best] += 1
    return votes.most_common(1)[0][0] if votes else None


def _compute_misfit(ids: NDArray[np.int64], centers: NDArray[np.float64], columns: int) -> float:
    """Return the median residual, in squares, of markers (n,) placed row by row on ``columns`` squares.

    OpenCV starts a row with a black square, legacy boards with an even number of rows start with a marker.
    """
    return min(_compute_grid_misfit(_place_markers(ids, columns, first), centers) for first in (1, 0))


def _place_markers(ids: NDArray[np.int64], columns: int, first: int) -> NDArray[np.float64]:
    """Return column and row (n, 2) of each marker if the first one is in column ``first``."""
    upper = (columns - first + 1) // 2  # markers in an even row
    pair, rest = np.divmod(ids, columns)
    lower = rest >= upper
    column = np.where(lower, 2 * (rest - upper) + (1 - first), 2 * rest + first)
    return np.stack([column, 2 * pair + lower], axis=-1).astype(np.float64)


def _compute_grid_misfit(grid: NDArray[np.float64], centers: NDArray[np.float64]) -> float:
    if min(np.ptp(grid, axis=0)) == 0:
        return np.inf
    homography, _ = cv2.findHomography(centers, grid, cv2.RANSAC, 0.3)
    if homography is None:
        return np.inf
    mapped = cv2.perspectiveTransform(centers.reshape(-1, 1, 2), homography).reshape(-1, 2)
    return float(np.median(np.linalg.norm(mapped - grid, axis=1)))


def _find_chessboard_grid(images: list[NDArray[np.uint8]]) -> tuple[int, int] | None:
    """Return the chessboard grid that most images show, longer side first; None without any."""
    votes: Counter[tuple[int, int]] = Counter()
    for image in images:
        scale = min(1.0, 960 / max(image.shape))
        small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE
        found, _, meta = cv2.findChessboardCornersSBWithMeta(small, (3, 3), flags)
        if found and meta.size >= 20:  # smaller grids occur by chance in any texture
            votes[max(meta.shape), min(meta.shape)] += 1
    return votes.most_common(1)[0][0] if votes else None
