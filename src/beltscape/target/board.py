"""Calibration boards, ChArUco and chessboard, as described in board.toml."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, Field, model_validator

from beltscape.core.errors import InputError
from beltscape.files.documents.toml_text import read_toml, validate
from beltscape.files.folders.paths import AnyPath, as_path

MIN_CORNERS = 8
"""Minimum number of corners of a view: fewer constrain the camera less than their noise disturbs it."""


def _check_dictionary(name: str) -> str:
    import cv2

    if not name.startswith("DICT_") or not hasattr(cv2.aruco, name):
        raise ValueError(f"no ArUco dictionary is called {name}; one is DICT_5X5_100")
    return name


def _load_dictionary(name: str) -> Any:
    import cv2

    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


class CharucoBoard(BaseModel, frozen=True, extra="forbid"):
    """A chessboard with ArUco markers in its white squares."""

    if TYPE_CHECKING:

        def __hash__(self) -> int: ...  # pydantic adds it to a frozen model

    kind: Literal["charuco"] = "charuco"
    squares: tuple[Annotated[int, Field(ge=2, le=200)], Annotated[int, Field(ge=2, le=200)]]
    square_mm: Annotated[float, Field(ge=0.01, le=10_000, allow_inf_nan=False)]
    marker_mm: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    dictionary: Annotated[str, AfterValidator(_check_dictionary)]
    legacy: bool | None = None
    inverted: bool | None = None

    @model_validator(mode="after")
    def _check_marker_size(self) -> CharucoBoard:
        if self.marker_mm >= self.square_mm:
            raise ValueError(
                f"marker_mm = {self.marker_mm:g} must be smaller than square_mm = {self.square_mm:g}"
            )
        return self

    @model_validator(mode="after")
    def _check_marker_count(self) -> CharucoBoard:
        (columns, rows), available = self.squares, len(_load_dictionary(self.dictionary).bytesList)
        if columns * rows // 2 > available:
            raise ValueError(
                f"squares = [{columns}, {rows}] need {columns * rows // 2} markers, "
                f"{self.dictionary} has {available}; correct squares or dictionary"
            )
        return self

    @model_validator(mode="after")
    def _check_corner_count(self) -> CharucoBoard:
        columns, rows = self.grid
        if columns * rows < MIN_CORNERS or min(columns, rows) < 2:
            raise ValueError(
                f"squares = [{self.squares[0]}, {self.squares[1]}] have {columns}×{rows} inner corners; a camera "
                f"needs {MIN_CORNERS} at least, in two rows or more"
            )
        return self

    @property
    def grid(self) -> tuple[int, int]:
        """Return the inner corners (columns, rows)."""
        return self.squares[0] - 1, self.squares[1] - 1

    def to_opencv(self, *, legacy: bool) -> Any:
        """Return OpenCV's board object."""
        import cv2

        dictionary = _load_dictionary(self.dictionary)
        board = cv2.aruco.CharucoBoard(self.squares, self.square_mm, self.marker_mm, dictionary)
        board.setLegacyPattern(legacy)
        return board

    def describe(self) -> str:
        """Describe the board in a few words."""
        return f"ChArUco {self.squares[0]}×{self.squares[1]}, {self.dictionary}, square {self.square_mm:g} mm"


class Chessboard(BaseModel, frozen=True, extra="forbid"):
    """A plain chessboard, described by its inner corners."""

    if TYPE_CHECKING:

        def __hash__(self) -> int: ...  # pydantic adds it to a frozen model

    kind: Literal["chessboard"] = "chessboard"
    corners: tuple[Annotated[int, Field(ge=3, le=200)], Annotated[int, Field(ge=3, le=200)]]
    square_mm: Annotated[float, Field(ge=0.01, le=10_000, allow_inf_nan=False)]

    @property
    def grid(self) -> tuple[int, int]:
        """Return the inner corners (columns, rows)."""
        return self.corners

    def describe(self) -> str:
        """Describe the board in a few words."""
        return f"chessboard {self.corners[0]}×{self.corners[1]} inner corners, square {self.square_mm:g} mm"


Board = CharucoBoard | Chessboard


def corner_points_mm(board: Board) -> NDArray[np.float64]:
    """Return (columns·rows, 3) inner corners in the board's frame, row by row from the first; z = 0."""
    columns, rows = board.grid
    x, y = np.meshgrid(np.arange(1, columns + 1), np.arange(1, rows + 1))
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=-1).astype(np.float64) * board.square_mm


def adjacent_corners(board: Board) -> NDArray[np.int64]:
    """Return (E, 2) indices of corners one square apart."""
    columns, rows = board.grid
    index = np.arange(columns * rows).reshape(rows, columns)
    across = np.stack([index[:, :-1].ravel(), index[:, 1:].ravel()], axis=-1)
    down = np.stack([index[:-1].ravel(), index[1:].ravel()], axis=-1)
    return np.concatenate([across, down])


def read_board(path: AnyPath) -> Board:
    """Read board.toml, or raise InputError naming the invalid key."""
    path = as_path(path)
    values = read_toml(path)
    kinds: dict[str, type[Board]] = {"charuco": CharucoBoard, "chessboard": Chessboard}
    if "kind" not in values:
        raise InputError(f'{path}: kind is missing; write kind = "charuco" or kind = "chessboard"')
    kind = values["kind"]
    if kind not in ("charuco", "chessboard"):
        raise InputError(f'{path}: kind = {kind!r}: must be "charuco" or "chessboard"')
    return validate(path, kinds[kind], values)
