"""A calibration board as a sheet to print in true size, with a ruler to check the print.

A page is chosen from the sizes of paper for the size that is asked for.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from math import ceil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import SettingsError
from beltscape.files.atomic import write_bytes, write_text
from beltscape.target.planar_boards import AprilGrid, CharucoBoard, PlanarBoard, load_dictionary
from beltscape.target.sheet import Sheet, outline_text, sheet_to_pdf, sheet_to_png, sheet_to_svg

PAPERS_MM: dict[str, tuple[float, float]] = {
    "A4": (210, 297),
    "A3": (297, 420),
    "A2": (420, 594),
    "A1": (594, 841),
    "A0": (841, 1189),
}
"""ISO 216, width and height in portrait, from small to large."""

LARGEST_MM = 5080.0
"""A PDF page is at most 14,400 points wide (ISO 32000-1, Annex C)."""


def choose_page(needed_mm: tuple[float, float], page: str | None) -> tuple[float, float]:
    """Return width and height in mm of a page that holds ``needed_mm``, in the better orientation.

    Parameters
    ----------
    page
        A4 … A0, or WxH in mm (used unrotated); None chooses the smallest sufficient one of A4 … A0.

    Raises
    ------
    SettingsError
        If the page is unknown or too small; the message names a sufficient one.
    """
    sizes = None if page is None else _page_sizes(page)
    for width, height in sizes or [size for name in PAPERS_MM for size in _page_sizes(name)]:
        landscape = width > height
        if _is_large_enough(needed_mm, (width, height)):
            rotated = (height, width)
            is_better = landscape != (needed_mm[0] > needed_mm[1]) and _is_large_enough(needed_mm, rotated)
            return rotated if is_better and sizes != [(width, height)] else (width, height)
    limit = "more than A0" if page is None else f"more than page {page}"
    raise SettingsError(
        f"the board with margin, ruler and text needs {ceil(needed_mm[0])}×{ceil(needed_mm[1])} mm, {limit}; "
        f"give {_suggest_page(needed_mm)}smaller squares"
    )


def _page_sizes(page: str) -> list[tuple[float, float]]:
    """Return the possible sizes of a page: a named one in portrait or landscape."""
    if page.upper() in PAPERS_MM:
        width, height = PAPERS_MM[page.upper()]
        return [(width, height), (height, width)]
    match = re.fullmatch(r"(\d+(?:\.\d+)?)[x×](\d+(?:\.\d+)?)", page)
    size = (float(match[1]), float(match[2])) if match else (0.0, 0.0)
    if min(size) <= 0 or max(size) > LARGEST_MM:
        raise SettingsError(
            f"page {page!r} is not known; give {', '.join(PAPERS_MM)}, or WxH in mm up to {LARGEST_MM:g}, as 600x400"
        )
    return [size]


def _is_large_enough(needed: tuple[float, float], page: tuple[float, float]) -> bool:
    return needed[0] <= page[0] + 1e-9 and needed[1] <= page[1] + 1e-9


def _suggest_page(needed: tuple[float, float]) -> str:
    """Return the smallest sufficient page as text, or an empty text."""
    for name in PAPERS_MM:
        if any(_is_large_enough(needed, size) for size in _page_sizes(name)):
            return f"page {name}, or "
    size = ceil(needed[0]), ceil(needed[1])
    return f"page {size[0]}x{size[1]}, or " if max(size) <= LARGEST_MM else ""


MARGIN_MM = 5.0
"""White margin on all sides, which most printers cannot print."""
RULER_MM = 100.0
"""Length of the ruler below the board, by which a print's scale is checked."""
FONT_MM = 2.6
"""Height of the text below the board: legible, and beside most boards on one line."""
FOOT_MM = 11.0
"""Height of ruler and text below the board."""


@dataclass(frozen=True, slots=True)
class PrintedBoard:
    """A board on its page."""

    board: PlanarBoard
    sheet: Sheet
    origin_mm: tuple[float, float]
    """The board's top-left corner on the page."""


def lay_out(board: PlanarBoard, page: str | None = None) -> PrintedBoard:
    """Lay a board out on a page (A4 … A0, WxH in mm, or None: the smallest sufficient one), or SettingsError.

    A ChArUco board is drawn as by OpenCV since 4.6, neither legacy nor inverted.
    """
    if isinstance(board, CharucoBoard):
        board = board.model_copy(update={"legacy": False, "inverted": False})
    size = _measure_board(board)
    outlines, text_mm = outline_text(make_caption(board), FONT_MM)
    width = max(size[0], RULER_MM + 1, text_mm)
    page_mm = choose_page((width + 2 * MARGIN_MM, size[1] + FOOT_MM + 2 * MARGIN_MM), page)
    x, y = (page_mm[0] - size[0]) / 2, (page_mm[1] - size[1] - FOOT_MM) / 2
    ruler_origin = ((page_mm[0] - RULER_MM) / 2, y + size[1] + 3.5)
    text_at = ((page_mm[0] - text_mm) / 2, y + size[1] + FOOT_MM - 0.8)
    rectangles = np.concatenate([_shift(black_squares(board), (x, y)), _shift(make_ruler(), ruler_origin)])
    sheet = Sheet(page_mm, make_caption(board), rectangles, tuple(outline + text_at for outline in outlines))
    return PrintedBoard(board, sheet, (x, y))


def _measure_board(board: PlanarBoard) -> tuple[float, float]:
    """Return width and height of the printed area, mm."""
    if isinstance(board, AprilGrid):
        return board.size_mm
    columns, rows = board.grid
    return (columns + 1) * board.square_mm, (rows + 1) * board.square_mm


def make_caption(board: PlanarBoard) -> str:
    """Return the description of the board that is printed below it."""
    if isinstance(board, CharucoBoard):
        description = (
            f"ChArUco, {board.squares[0]} × {board.squares[1]} squares of {board.square_mm:g} mm, "
            f"markers {board.marker_mm:g} mm, {board.dictionary}"
            + (f" from id {board.first_id}" if board.first_id else "")
        )
    elif isinstance(board, AprilGrid):
        description = (
            f"AprilGrid, {board.tags[0]} × {board.tags[1]} tags of {board.tag_mm:g} mm, spacing {board.spacing:g}, "
            f"{board.dictionary}" + (f" from id {board.first_id}" if board.first_id else "")
        )
    else:
        columns, rows = board.corners
        description = f"chessboard, {columns} × {rows} inner corners, squares of {board.square_mm:g} mm"
    return f"{description}; print at 100 %: the ruler is {RULER_MM:g} mm long"


def black_squares(board: PlanarBoard) -> NDArray[np.float64]:
    """Return (R, 4) x, y, width, height in mm of the black rectangles, from the board's top-left corner."""
    if isinstance(board, AprilGrid):
        return np.concatenate([_corner_squares(board), *_tag_bits(board)])
    columns, rows = board.grid
    row, column = np.indices((rows + 1, columns + 1), dtype=np.float64)
    # OpenCV since 4.6 and the chessboard agree: the top left square is black
    black = (row + column) % 2 == 0
    squares = np.stack([column[black], row[black], np.ones(black.sum()), np.ones(black.sum())], axis=-1)
    markers = _marker_bits(board) if isinstance(board, CharucoBoard) else []
    return np.concatenate([squares * board.square_mm, *markers])


def _marker_bits(board: CharucoBoard) -> list[NDArray[np.float64]]:
    """Return (R, 4) black bits of each marker, merged along rows."""
    opencv_board = board.to_opencv(legacy=False)
    dictionary = opencv_board.getDictionary()
    bits = int(dictionary.markerSize) + 2  # the border is one bit wide
    bit_mm = board.marker_mm / bits
    boxes: list[NDArray[np.float64]] = []
    for number, corners in zip(
        opencv_board.getIds().ravel().tolist(), opencv_board.getObjPoints(), strict=True
    ):
        cell = np.floor(np.asarray(corners, dtype=np.float64)[:, :2].min(axis=0) / board.square_mm)
        corner = cell * board.square_mm + (board.square_mm - board.marker_mm) / 2  # in double precision
        runs = _runs(dictionary.generateImageMarker(number, bits) == 0)
        boxes.append(_shift(runs * bit_mm, corner))
    return boxes


def _corner_squares(board: AprilGrid) -> NDArray[np.float64]:
    """Return (R, 4) the small squares at the corners of an AprilGrid's tags."""
    gap = board.spacing * board.tag_mm
    row, column = np.indices((board.tags[1] + 1, board.tags[0] + 1), dtype=np.float64)
    edge = np.full(row.size, gap)
    return np.stack(
        [column.ravel() * (board.tag_mm + gap), row.ravel() * (board.tag_mm + gap), edge, edge], axis=-1
    )


def _tag_bits(board: AprilGrid) -> list[NDArray[np.float64]]:
    """Return (R, 4) black bits of each tag, upside down against OpenCV's drawing, as Kalibr prints them."""
    dictionary = load_dictionary(board.dictionary)
    bits = int(dictionary.markerSize) + 2 * board.border_bits
    corners = board.corners_mm()[board.tag_corners()[:, 0]]
    boxes: list[NDArray[np.float64]] = []
    for number, corner in zip(board.marker_ids, corners, strict=True):
        tag = dictionary.generateImageMarker(number, bits, borderBits=board.border_bits)
        boxes.append(_shift(_runs(tag[::-1, ::-1] == 0) * (board.tag_mm / bits), corner))
    return boxes


def _shift(boxes: NDArray[np.float64], by: Iterable[float]) -> NDArray[np.float64]:
    """Return boxes (R, 4) shifted by x, y."""
    return boxes + np.array([*by, 0, 0])


def _runs(black: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return (R, 4) x, y, length, 1 of runs of black cells in a row."""
    steps = np.diff(np.pad(black, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, start = np.nonzero(steps == 1)
    end = np.nonzero(steps == -1)[1]
    return np.stack([start, row, end - start, np.ones_like(row)], axis=-1).astype(np.float64)


def make_ruler() -> NDArray[np.float64]:
    """Return (R, 4) boxes of a ruler: the centres of its end ticks are at x = 0 and x = RULER_MM."""
    at = np.arange(RULER_MM + 1)
    long = np.where(at % 10 == 0, 3.0, np.where(at % 5 == 0, 2.2, 1.4))
    thick = 0.15
    ticks = np.stack([at - thick / 2, np.zeros(at.size), np.full(at.size, thick), long], axis=-1)
    line = np.array([[-thick / 2, 0, RULER_MM + thick, thick]])
    return np.concatenate([line, ticks])


def board_to_toml(board: PlanarBoard) -> str:
    """Return board.toml of a board as it is printed."""
    if isinstance(board, CharucoBoard):
        return (
            f'kind = "charuco"\nsquares = [{board.squares[0]}, {board.squares[1]}]\n'
            f"square_mm = {board.square_mm!r}\nmarker_mm = {board.marker_mm!r}\n"
            f'dictionary = "{board.dictionary}"\n'
            + (f"first_id = {board.first_id}\n" if board.first_id else "")
            + "legacy = false\ninverted = false\n"
        )
    if isinstance(board, AprilGrid):
        return (
            f'kind = "aprilgrid"\ntags = [{board.tags[0]}, {board.tags[1]}]\ntag_mm = {board.tag_mm!r}\n'
            f"spacing = {board.spacing!r}\n"
            + (f"first_id = {board.first_id}\n" if board.first_id else "")
            + f'border_bits = {board.border_bits}\ndictionary = "{board.dictionary}"\n'
        )
    return (
        f'kind = "chessboard"\ncorners = [{board.corners[0]}, {board.corners[1]}]\n'
        f"square_mm = {board.square_mm!r}\n"
    )


def write_board_files(folder: Path, printed: PrintedBoard, dpi: float = 300) -> dict[str, Path]:
    """Write board.pdf, board.svg, board.png and board.toml; return their paths."""
    png = sheet_to_png(printed.sheet, dpi)
    files = {kind: folder / f"board.{kind}" for kind in ("pdf", "svg", "png", "toml")}
    write_bytes(files["pdf"], sheet_to_pdf(printed.sheet))
    write_text(files["svg"], sheet_to_svg(printed.sheet))
    write_bytes(files["png"], png)
    write_text(files["toml"], board_to_toml(printed.board))
    return files
