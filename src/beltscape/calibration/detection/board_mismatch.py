"""Comparison of the board that images show with the described one: what is wrong in board.toml."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.target.board import AprilGrid, Board, CharucoBoard, Chessboard
from beltscape.target.planar_boards import load_dictionary

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

_FIT = 0.25
"""Residual of a marker's centre, in squares, up to which it fits a layout: markers of another layout lie whole
squares off, those of a bent board or a wide lens less than a tenth."""
_FITTING_SHARE, _MORE = 0.8, 2
"""Share of the markers that fit the right layout at least, and markers more than under the stated one: the layouts of
boards with an even number of rows differ, but for a shift, in one marker of two rows only."""
_INSET_PX = 1.0
"""Pixels by which a marker's edge is measured too short: its contour goes through the centres of its outer pixels."""
_MARKER_TOLERANCE = 0.1
"""Relative difference of a marker's edge from the stated one that is an error: blur and exposure move a contour by a
pixel at most, which is a tenth of the smallest markers that are read."""

Markers = list[tuple[NDArray[np.int64], NDArray[np.float64]]]
"""One (ids (n,), centres (n, 2) px) per image."""
Family = tuple[str, bool]
"""The largest dictionary of a family, and whether its markers are inverted."""


@dataclass(frozen=True, slots=True)
class Layout:
    """The keys of board.toml that place a board's markers."""

    squares: tuple[int, int]
    legacy: bool
    inverted: bool


def describe_contradiction(
    images: Iterable[NDArray[np.uint8]], board: CharucoBoard, *, legacy: bool, inverted: bool
) -> str | None:
    """Return the keys of board.toml with the values that the markers in images (H, W) uint8 fit, where these differ.

    Markers' centres do not depend on marker_mm, so that they tell the layout: exchanged columns and rows, or the
    other layout. In the right layout their corners measure marker_mm. None where the description fits, or no layout
    does.
    """
    views = list(images)
    is_inverted, markers = _detect_either_print(views, board, inverted=inverted)
    columns, rows = board.squares
    if not markers:
        return None
    options = [
        Layout(squares, is_legacy, is_inverted)
        for squares in dict.fromkeys([(columns, rows), (rows, columns)])
        for is_legacy in (legacy, not legacy)
    ]
    total = sum(len(ids) for ids, _ in markers)
    scores = [sum(_count_fitting(each, board, options[0]) for each in markers)]
    if scores[0] <= total - _MORE:  # else no other layout can fit so many markers more
        scores += [sum(_count_fitting(each, board, option) for each in markers) for option in options[1:]]
    found = options[int(np.argmax(scores)) if max(scores) >= scores[0] + _MORE else 0]
    if max(scores) < _FITTING_SHARE * total:
        return None
    edge_mm = _measure_edge(markers, board, found)
    keys = [f"squares = [{rows}, {columns}]"] if found.squares != (columns, rows) else []
    if found.legacy != legacy and board.legacy is not None:
        keys.append(f"legacy = {str(found.legacy).lower()} (or no such key)")
    if is_inverted != inverted and board.inverted is not None:
        keys.append(f"inverted = {str(is_inverted).lower()} (or no such key)")
    if abs(edge_mm / board.marker_mm - 1) > _MARKER_TOLERANCE:
        keys.append(f"marker_mm = {edge_mm:.3g} (measured, where square_mm = {board.square_mm:g})")
    return " and ".join(keys) or None


def _detect_either_print(
    images: list[NDArray[np.uint8]], board: CharucoBoard, *, inverted: bool
) -> tuple[bool, Markers]:
    """Return whether images show inverted markers, and the markers: as stated, unless far more of them are not.

    Where half of all markers are as stated, the images are not searched for others.
    """
    stated = list(_detect_quads(images, board, inverted=inverted))
    count = sum(len(ids) for ids, _ in stated)
    if 2 * count >= len(images) * len(board.marker_ids):
        return inverted, stated
    others = list(_detect_quads(images, board, inverted=not inverted))
    return (not inverted, others) if sum(len(ids) for ids, _ in others) > 2 * count else (inverted, stated)


def _detect_quads(
    images: Iterable[NDArray[np.uint8]], board: CharucoBoard, *, inverted: bool
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
    """Yield the ids (n,) and corners (n, 4, 2) of a board's markers in each image with enough of them."""
    detector = cv2.aruco.ArucoDetector(load_dictionary(board.dictionary))
    for image in images:
        corners, ids, _ = detector.detectMarkers(cv2.bitwise_not(image) if inverted else image)
        if ids is None:
            continue
        numbers, quads = ids.ravel().astype(np.int64), np.array(corners, np.float64).reshape(-1, 4, 2)
        own = np.isin(numbers, np.array(board.marker_ids))
        if own.sum() >= _FEWEST:
            yield numbers[own], quads[own]


def _map_to_board(
    ids: NDArray[np.int64], quads: NDArray[np.float64], board: CharucoBoard, layout: Layout
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return markers' corners (n, 4, 2) on a board, mm, and the misfits (n,) of their centres, in squares."""
    drawn = board.model_copy(update={"squares": layout.squares}).to_opencv(legacy=layout.legacy)
    centers_mm = {
        int(number): np.asarray(points, np.float64)[:, :2].mean(axis=0)
        for number, points in zip(drawn.getIds().ravel(), drawn.getObjPoints(), strict=True)
    }
    wanted, centers = np.array([centers_mm[int(number)] for number in ids]), quads.mean(axis=1)
    homography, _ = cv2.findHomography(centers, wanted, cv2.RANSAC, 0.3 * board.square_mm)
    if homography is None:
        return quads, np.full(len(ids), np.inf)
    mapped = cv2.perspectiveTransform(quads.reshape(-1, 1, 2), homography).reshape(-1, 4, 2)
    return mapped, np.linalg.norm(mapped.mean(axis=1) - wanted, axis=1) / board.square_mm


def _count_fitting(
    markers: tuple[NDArray[np.int64], NDArray[np.float64]], board: CharucoBoard, layout: Layout
) -> int:
    return int((_map_to_board(*markers, board, layout)[1] < _FIT).sum())


def _measure_edge(markers: Markers, board: CharucoBoard, layout: Layout) -> float:
    """Return the median edge of the markers on a board of this layout, mm."""
    edges: list[float] = []
    for ids, quads in markers:
        mapped, misfit = _map_to_board(ids, quads, board, layout)
        lengths_mm, lengths_px = (
            np.linalg.norm(each - np.roll(each, 1, axis=1), axis=2)[misfit < _FIT] for each in (mapped, quads)
        )
        edges += (lengths_mm * (1 + _INSET_PX / lengths_px)).ravel().tolist()
    return float(np.median(edges))


_CHESSBOARD_IMAGES = 96
"""Images that are searched for a chessboard of unknown size, which takes a second each."""


def describe_shown_board(read_images: Callable[[], Iterable[NDArray[np.uint8]]], board: Board) -> str | None:
    """Describe the board that images (H, W) uint8 show, as far as it can be determined; None without any board.

    ``read_images`` reads them one by one, for there may be more than memory holds.
    """
    markers, family, is_inverted = _find_family(read_images())
    if _count_markers(markers) >= _FEWEST:
        low, top = (int(limit(limit(ids) for ids, _ in markers)) for limit in (min, max))
        shifted = [(ids - low, centers) for ids, centers in markers]
        columns = _estimate_columns(markers) or _estimate_columns(shifted)
        # two rows hold as many markers as a row has squares; the first ones are rarely hidden in every image
        begins_later = columns is not None and low >= columns
        numbers = f"{low} to {top} (first_id = {low})" if begins_later else f"up to {top}"
        squares = f" on a board of {columns} columns" if columns else ""
        note = ", inverted" if is_inverted else ""
        return f"markers {_name_dictionary(family, top, board)} with ids {numbers}{squares}{note}"
    grid = _find_chessboard_grid(list(islice(read_images(), _CHESSBOARD_IMAGES)))
    if grid and not (isinstance(board, Chessboard) and grid in (board.corners, board.corners[::-1])):
        return f"a chessboard of {grid[0]}×{grid[1]} inner corners"
    return None


def _find_family(images: Iterable[NDArray[np.uint8]]) -> tuple[Markers, str, bool]:
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


def _name_dictionary(family: str, top: int, board: Board) -> str:
    """Return the stated dictionary if it is of this family, else its smallest one that contains the id ``top``."""
    stated = board.dictionary if isinstance(board, CharucoBoard | AprilGrid) else ""
    name, _, size = stated.rpartition("_")
    if name == family.removesuffix("_1000") and size.isdigit() and top < int(size):
        return stated
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
            if fits[best] < _FIT:
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
