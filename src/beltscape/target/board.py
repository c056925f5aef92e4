"""Calibration boards as described in board.toml: one planar board, or several.

Kalibr's description of a target, ``target.yaml``, is read as a board: ``target_type`` is ``aprilgrid`` with
``tagCols``, ``tagRows``, ``tagSize`` (m) and ``tagSpacing`` (gap over tagSize), or ``checkerboard`` with
``targetCols``, ``targetRows`` (inner corners), ``colSpacingMeters``, ``rowSpacingMeters``.

Source: https://github.com/ethz-asl/kalibr/wiki/calibration-targets
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.checks import is_dict, is_list
from beltscape.core.errors import InputError
from beltscape.core.quantities import SQUARE, suggest_unit
from beltscape.files.exchange.documents import read_document
from beltscape.files.paths import AnyPath, as_path
from beltscape.files.toml_text import read_toml, validate
from beltscape.target.board_set import BoardSet
from beltscape.target.planar_boards import MIN_CORNERS, AprilGrid, CharucoBoard, Chessboard, PlanarBoard

SUFFIXES = (".yaml", ".yml")
MM_PER_M = 1000.0
"""Kalibr's lengths are in metres."""
NANOMETRES = 6
"""Decimals of a length in mm: metres times 1000 leave rounding behind."""


def read_kalibr_target(path: Path) -> PlanarBoard:
    """Return the board of a target.yaml.

    Raises
    ------
    InputError
        With the key that is missing or wrong, or when the target is one of circles.
    """
    values = read_document(path)
    kind = values.get("target_type") if is_dict(values) else None
    if not is_dict(values) or kind not in ("aprilgrid", "checkerboard"):
        raise InputError(
            f"{path}: target_type = {kind!r}: must be 'aprilgrid' or 'checkerboard'; describe other boards in "
            "board.toml"
        )
    if kind == "aprilgrid":
        found = {
            "tags": [_get(path, values, "tagCols"), _get(path, values, "tagRows")],
            "tag_mm": _get_mm(path, values, "tagSize"),
            "spacing": _get(path, values, "tagSpacing"),
        }
        return validate(path, AprilGrid, found)
    across, down = _get_mm(path, values, "colSpacingMeters"), _get_mm(path, values, "rowSpacingMeters")
    if across != down:
        raise InputError(
            f"{path}: colSpacingMeters = {values['colSpacingMeters']} and rowSpacingMeters = "
            f"{values['rowSpacingMeters']} differ; only boards of squares are supported"
        )
    corners = [_get(path, values, "targetCols"), _get(path, values, "targetRows")]
    return validate(path, Chessboard, {"corners": corners, "square_mm": across})


def _get(path: Path, values: dict[str, Any], key: str) -> Any:
    if values.get(key) is None:
        raise InputError(f"{path}: {key} is missing")
    return values[key]


def _get_mm(path: Path, values: dict[str, Any], key: str) -> float:
    value = _get(path, values, key)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{path}: {key} = {value!r}: must be a length in metres")
    if value > 0 and SQUARE.find_refusal(value * MM_PER_M):
        fix = suggest_unit(value, "m", lambda metres: not SQUARE.find_refusal(metres * MM_PER_M))
        raise InputError(f"{path}: {key} = {value!r}: must be a length in metres{fix}")
    return round(value * MM_PER_M, NANOMETRES)


__all__ = [
    "MIN_CORNERS", "AprilGrid", "Board", "BoardSet", "CharucoBoard", "Chessboard", "PlanarBoard", "adjacent_corners",
    "corner_points_mm", "list_triples", "outer_corners", "outline_corners", "parse_board", "read_board",
]  # fmt: skip

Board = CharucoBoard | Chessboard | AprilGrid | BoardSet

_MODELS: dict[str, type[PlanarBoard]] = {
    "charuco": CharucoBoard,
    "chessboard": Chessboard,
    "aprilgrid": AprilGrid,
}
_PLACE_KEYS = ("origin_mm", "x_axis", "y_axis")


def corner_points_mm(board: Board) -> NDArray[np.float64]:
    """Return the corners (P, 3) in the board's frame, mm; of one board row by row from the first, with z = 0."""
    corners = board.corners_mm()
    return corners if corners.shape[1] == 3 else np.column_stack([corners, np.zeros(len(corners))])


def adjacent_corners(board: Board) -> NDArray[np.int64]:
    """Return (E, 2) indices of corners one square apart; of an AprilGrid, of corners along one tag's edge."""
    if isinstance(board, BoardSet):
        return _join_faces(board, adjacent_corners)
    columns, rows = board.grid
    index = np.arange(columns * rows).reshape(rows, columns)
    step = 2 if isinstance(board, AprilGrid) else 1  # between two tags is a gap, not a square
    across = np.stack([index[:, :-1:step].ravel(), index[:, 1::step].ravel()], axis=-1)
    down = np.stack([index[:-1:step].ravel(), index[1::step].ravel()], axis=-1)
    return np.concatenate([across, down])


def list_triples(board: Board) -> NDArray[np.int64]:
    """Return (T, 3) indices of three consecutive corners of a row or column, equally far apart."""
    if isinstance(board, BoardSet):
        return _join_faces(board, list_triples)
    columns, rows = board.grid
    index = np.arange(columns * rows).reshape(rows, columns)
    step = (
        2 if isinstance(board, AprilGrid) else 1
    )  # every second corner of an AprilGrid is equally far apart
    across = np.stack([index[:, : -2 * step], index[:, step:-step], index[:, 2 * step :]], axis=-1)
    down = np.stack([index[: -2 * step], index[step:-step], index[2 * step :]], axis=-1)
    return np.concatenate([across.reshape(-1, 3), down.reshape(-1, 3)])


def outline_corners(board: Board) -> NDArray[np.int64]:
    """Return the indices (n,) of the corners along the board's edge, in order; of a set, board by board."""
    if isinstance(board, BoardSet):
        return _join_faces(board, outline_corners)
    columns, rows = board.grid
    index = np.arange(columns * rows).reshape(rows, columns)
    return np.concatenate([index[0], index[1:, -1], index[-1, -2::-1], index[-2::-1, 0]])


def _join_faces(
    boards: BoardSet, list_corners: Callable[[PlanarBoard], NDArray[np.int64]]
) -> NDArray[np.int64]:
    """Return the corners that a function lists of each board, numbered through the set."""
    starts = zip(boards.faces, boards.offsets, strict=False)  # the last offset is the set's end
    return np.concatenate([list_corners(face.board) + start for face, start in starts])


def outer_corners(board: Board) -> NDArray[np.int64]:
    """Return the indices (4,) of a board's outermost corners, in order; of a set, those of its first board."""
    columns, rows = board.faces[0].board.grid if isinstance(board, BoardSet) else board.grid
    return np.array([0, columns - 1, rows * columns - 1, (rows - 1) * columns])


def read_board(path: AnyPath) -> Board:
    """Read board.toml, or Kalibr's target.yaml; raise InputError naming the invalid key."""
    path = as_path(path)
    if path.suffix.lower() in SUFFIXES:
        return read_kalibr_target(path)
    return parse_board(path, read_toml(path))


def parse_board(path: Path, values: dict[str, Any]) -> Board:
    """Return the board of the keys of board.toml; InputError naming ``path`` and the invalid key."""
    if "boards" in values:
        return _parse_set(path, values)
    if values.get("kind") == "boards":
        return validate(path, BoardSet, values)
    return validate(path, _select_model(str(path), values), values)


def _select_model(place: str, values: dict[str, Any]) -> type[PlanarBoard]:
    choices = '"charuco", "chessboard" or "aprilgrid"'
    if "kind" not in values:
        raise InputError(f"{place}: kind is missing; write kind = {choices}")
    model = next((_MODELS[kind] for kind in _MODELS if kind == values["kind"]), None)
    if model is None:
        raise InputError(f"{place}: kind = {values['kind']!r}: must be {choices}")
    return model


def _parse_set(path: Path, values: dict[str, Any]) -> BoardSet:
    """Return the set of the tables [[boards]]."""
    tables = values["boards"]
    faces: list[dict[str, Any]] = []
    for number, table in enumerate(tables if is_list(tables) else [tables]):
        if not is_dict(table):
            raise InputError(f"{path}: boards must be tables, each begun by a line [[boards]]")
        place = f"{path}: boards[{number}]"
        described = {key: value for key, value in table.items() if key not in ("name", *_PLACE_KEYS)}
        validate(Path(place), _select_model(place, described), described)
        placed = {key: table[key] for key in _PLACE_KEYS if key in table}
        name = table.get("name", str(number))
        faces.append({"name": name, "board": described, "placement": placed or None})
    others = {key: value for key, value in values.items() if key not in ("boards", "kind")}
    return validate(path, BoardSet, {**others, "faces": faces})
