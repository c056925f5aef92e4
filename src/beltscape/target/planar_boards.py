"""Planar calibration boards: ChArUco, chessboard and AprilGrid, with the numbering of their corners."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, Field, model_validator

from beltscape.core.quantities import MARKER, SQUARE

MIN_CORNERS = 8
"""Minimum number of corners of a view: fewer constrain the camera less than their noise disturbs it."""

Count = Annotated[int, Field(ge=2, le=200)]
Length = Annotated[float, SQUARE]
LengthSigma = Annotated[float, Field(ge=0, le=50, allow_inf_nan=False)]
LengthSigmas = LengthSigma | tuple[LengthSigma, LengthSigma]
"""One standard deviation of a length, the same error in all of them, or two: of independent errors along rows and
along columns."""
MAX_LENGTH_SIGMA = 0.05
"""Largest standard deviation of a length over the length: more is no certificate, but a figure in another unit."""
Thickness = Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)]
MarkerId = Annotated[int, Field(ge=0, le=100_000)]


def _check_dictionary(name: str) -> str:
    import cv2

    if not name.startswith("DICT_") or not hasattr(cv2.aruco, name):
        raise ValueError(f"no ArUco dictionary is called {name}; one is DICT_5X5_100")
    return name


def load_dictionary(name: str) -> Any:
    """Return OpenCV's predefined dictionary of a name such as DICT_5X5_100."""
    import cv2

    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def load_markers(name: str, count: int) -> Any:
    """Return the first ``count`` markers of a dictionary without error correction, or else the whole dictionary.

    A detector compares every candidate with every marker: 200 of 1000 take a third of the time, and find the same.
    Where errors are corrected, a candidate may be nearest to a marker that is not on the board, so that all remain.
    """
    import cv2

    dictionary = load_dictionary(name)
    if dictionary.maxCorrectionBits:
        return dictionary
    return cv2.aruco.Dictionary(dictionary.bytesList[:count], dictionary.markerSize, 0)


def _check_sigma(name: str, sigma_mm: LengthSigmas | None, length_mm: float) -> None:
    largest_mm = max(sigma_mm) if isinstance(sigma_mm, tuple) else sigma_mm
    if largest_mm is not None and largest_mm > MAX_LENGTH_SIGMA * length_mm:
        raise ValueError(
            f"{name} = {largest_mm:g}: must be at most {MAX_LENGTH_SIGMA:.0%} of the {length_mm:g} mm; give one "
            "standard deviation of one such length: that of a measured row over the number of lengths in it"
        )


def _compute_axis_sigma(sigma_mm: LengthSigmas | None, length_mm: float) -> tuple[float, float] | None:
    """Return the relative standard deviations along rows and columns; None if the two have one error."""
    return (sigma_mm[0] / length_mm, sigma_mm[1] / length_mm) if isinstance(sigma_mm, tuple) else None


def _compute_scale_sigma(sigma_mm: LengthSigmas | None, length_mm: float) -> float:
    """Return the relative standard deviation of the size, that of the mean of both directions."""
    mean_mm = np.hypot(*sigma_mm) / 2 if isinstance(sigma_mm, tuple) else sigma_mm or 0.0
    return float(mean_mm) / length_mm


class CharucoBoard(BaseModel, frozen=True, extra="forbid"):
    """A chessboard with ArUco markers in its white squares."""

    if TYPE_CHECKING:

        def __hash__(self) -> int: ...  # pydantic adds it to a frozen model

    kind: Literal["charuco"] = "charuco"
    squares: tuple[Count, Count]
    square_mm: Length
    square_sigma_mm: LengthSigmas | None = None
    """One standard deviation of ``square_mm``, the same error in all squares, by the certificate; None: exact. Two
    are those of independent errors along rows and along columns."""
    marker_mm: Annotated[float, MARKER]
    dictionary: Annotated[str, AfterValidator(_check_dictionary)]
    first_id: MarkerId = 0
    """The id of the first marker; the others follow it row by row."""
    legacy: bool | None = None
    inverted: bool | None = None
    thickness_mm: Thickness | None = None
    """Distance of a print on the back from that on the front; None: estimated from the views."""

    @model_validator(mode="after")
    def _check_square_sigma(self) -> CharucoBoard:
        _check_sigma("square_sigma_mm", self.square_sigma_mm, self.square_mm)
        return self

    @model_validator(mode="after")
    def _check_marker_size(self) -> CharucoBoard:
        if self.marker_mm >= self.square_mm:
            raise ValueError(
                f"marker_mm = {self.marker_mm:g} must be smaller than square_mm = {self.square_mm:g}"
            )
        return self

    @model_validator(mode="after")
    def _check_marker_count(self) -> CharucoBoard:
        (columns, rows), available = self.squares, len(load_dictionary(self.dictionary).bytesList)
        if self.marker_ids.stop > available:
            first = f" from first_id = {self.first_id} on" if self.first_id else ""
            raise ValueError(
                f"squares = [{columns}, {rows}] need {columns * rows // 2} markers{first}, "
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

    @property
    def scale_sigma(self) -> float:
        """Return the relative standard deviation of the board's size."""
        return _compute_scale_sigma(self.square_sigma_mm, self.square_mm)

    @property
    def axis_sigma(self) -> tuple[float, float] | None:
        """Return the relative standard deviations of lengths along rows and columns; None if they have one error."""
        return _compute_axis_sigma(self.square_sigma_mm, self.square_mm)

    @property
    def marker_ids(self) -> range:
        """Return the ids of the board's markers, row by row."""
        return range(self.first_id, self.first_id + self.squares[0] * self.squares[1] // 2)

    def corners_mm(self) -> NDArray[np.float64]:
        """Return the corners (columns·rows, 2), row by row, mm."""
        return _square_corners_mm(self.grid, self.square_mm)

    def to_opencv(self, *, legacy: bool) -> Any:
        """Return OpenCV's board object."""
        import cv2

        ids = np.array(self.marker_ids, np.int32)
        board = cv2.aruco.CharucoBoard(
            self.squares,
            self.square_mm,
            self.marker_mm,
            load_markers(self.dictionary, max(self.marker_ids) + 1),
            ids,
        )
        board.setLegacyPattern(legacy)
        return board

    def describe(self) -> str:
        """Describe the board in a few words."""
        first = f" from id {self.first_id}" if self.first_id else ""
        return (
            f"ChArUco {self.squares[0]}×{self.squares[1]}, {self.dictionary}{first}, square "
            f"{_describe_length(self.square_mm, self.square_sigma_mm)}"
        )


class Chessboard(BaseModel, frozen=True, extra="forbid"):
    """A plain chessboard, described by its inner corners."""

    if TYPE_CHECKING:

        def __hash__(self) -> int: ...  # pydantic adds it to a frozen model

    kind: Literal["chessboard"] = "chessboard"
    corners: tuple[Annotated[int, Field(ge=3, le=200)], Annotated[int, Field(ge=3, le=200)]]
    square_mm: Length
    square_sigma_mm: LengthSigmas | None = None
    """One standard deviation of ``square_mm``, the same error in all squares, by the certificate; None: exact. Two
    are those of independent errors along rows and along columns."""

    @model_validator(mode="after")
    def _check_square_sigma(self) -> Chessboard:
        _check_sigma("square_sigma_mm", self.square_sigma_mm, self.square_mm)
        return self

    @property
    def scale_sigma(self) -> float:
        """Return the relative standard deviation of the board's size."""
        return _compute_scale_sigma(self.square_sigma_mm, self.square_mm)

    @property
    def axis_sigma(self) -> tuple[float, float] | None:
        """Return the relative standard deviations of lengths along rows and columns; None if they have one error."""
        return _compute_axis_sigma(self.square_sigma_mm, self.square_mm)

    @property
    def grid(self) -> tuple[int, int]:
        """Return the inner corners (columns, rows)."""
        return self.corners

    def corners_mm(self) -> NDArray[np.float64]:
        """Return the corners (columns·rows, 2), row by row, mm."""
        return _square_corners_mm(self.grid, self.square_mm)

    def describe(self) -> str:
        """Describe the board in a few words."""
        length = _describe_length(self.square_mm, self.square_sigma_mm)
        return f"chessboard {self.corners[0]}×{self.corners[1]} inner corners, square {length}"


class AprilGrid(BaseModel, frozen=True, extra="forbid"):
    """Kalibr's grid of AprilTags, with a small black square at every tag's corner.

    Tags are numbered as by Kalibr: row by row from the bottom left one upwards. Corners are numbered as
    those of every other board: row by row from the top left one downwards, two rows and two columns to a tag.

    References
    ----------
    Kalibr's wiki, "Calibration targets": tagCols, tagRows, tagSize (m), tagSpacing (gap over tagSize), family 36h11.
    """

    if TYPE_CHECKING:

        def __hash__(self) -> int: ...  # pydantic adds it to a frozen model

    kind: Literal["aprilgrid"] = "aprilgrid"
    tags: tuple[Annotated[int, Field(ge=1, le=100)], Annotated[int, Field(ge=1, le=100)]]
    """Columns and rows of tags."""
    tag_mm: Length
    """Edge of a tag's black border."""
    tag_sigma_mm: LengthSigmas | None = None
    """One standard deviation of ``tag_mm``, the same error in all tags, by the certificate; None: exact. Two are
    those of independent errors along rows and along columns."""
    spacing: Annotated[float, Field(gt=0.05, lt=2)]
    """Gap between tags over ``tag_mm``."""
    first_id: MarkerId = 0
    """The id of the bottom left tag."""
    border_bits: Literal[1, 2] = 2
    """Width of a tag's black border, in bits of the tag: Kalibr prints two."""
    dictionary: Annotated[str, AfterValidator(_check_dictionary)] = "DICT_APRILTAG_36h11"
    thickness_mm: Thickness | None = None
    """Distance of a print on the back from that on the front; None: estimated from the views."""

    @model_validator(mode="after")
    def _check_tag_sigma(self) -> AprilGrid:
        _check_sigma("tag_sigma_mm", self.tag_sigma_mm, self.tag_mm)
        return self

    @model_validator(mode="after")
    def _check_tag_count(self) -> AprilGrid:
        (columns, rows), available = self.tags, len(load_dictionary(self.dictionary).bytesList)
        if self.marker_ids.stop > available:
            raise ValueError(
                f"tags = [{columns}, {rows}] need ids up to {self.marker_ids.stop - 1}, {self.dictionary} ends at "
                f"{available - 1}; correct tags or first_id"
            )
        if columns * rows < 2:
            raise ValueError("tags = [1, 1] have 4 corners; a camera needs 8 at least, of two tags or more")
        return self

    @property
    def grid(self) -> tuple[int, int]:
        """Return the tags' corners (columns, rows)."""
        return 2 * self.tags[0], 2 * self.tags[1]

    @property
    def square_mm(self) -> float:
        """Return the length of the edges that `adjacent_corners` connects."""
        return self.tag_mm

    @property
    def scale_sigma(self) -> float:
        """Return the relative standard deviation of the board's size."""
        return _compute_scale_sigma(self.tag_sigma_mm, self.tag_mm)

    @property
    def axis_sigma(self) -> tuple[float, float] | None:
        """Return the relative standard deviations of lengths along rows and columns; None if they have one error."""
        return _compute_axis_sigma(self.tag_sigma_mm, self.tag_mm)

    @property
    def marker_ids(self) -> range:
        """Return the ids of the board's tags."""
        return range(self.first_id, self.first_id + self.tags[0] * self.tags[1])

    @property
    def size_mm(self) -> tuple[float, float]:
        """Return width and height with the outermost small squares."""
        gap = self.spacing * self.tag_mm
        return gap + self.tags[0] * (self.tag_mm + gap), gap + self.tags[1] * (self.tag_mm + gap)

    @property
    def clear_share(self) -> float:
        """Return the distance of a tag's corner from edges other than its own, over ``tag_mm``."""
        bits = int(load_dictionary(self.dictionary).markerSize) + 2 * self.border_bits
        return min(self.spacing, self.border_bits / bits)

    def corners_mm(self) -> NDArray[np.float64]:
        """Return the corners (columns·rows, 2), row by row, mm; the origin is the small square's outer corner."""
        gap = self.spacing * self.tag_mm
        x, y = (
            np.concatenate([gap + i * (self.tag_mm + gap) + np.array([0.0, self.tag_mm]) for i in range(n)])
            for n in self.tags
        )
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)

    def tag_corners(self) -> NDArray[np.int64]:
        """Return (tags, 4) corners of each tag, by id: top left, top right, bottom right, bottom left."""
        columns, rows = self.tags
        row, column = np.divmod(np.arange(columns * rows), columns)
        top_left = 2 * (rows - 1 - row) * self.grid[0] + 2 * column
        return top_left[:, None] + np.array([0, 1, self.grid[0] + 1, self.grid[0]])

    def describe(self) -> str:
        """Describe the board in a few words."""
        length = _describe_length(self.tag_mm, self.tag_sigma_mm)
        return f"AprilGrid {self.tags[0]}×{self.tags[1]} tags of {length}, spacing {self.spacing:g}"


SquareBoard = CharucoBoard | Chessboard
"""Boards that are simulated."""
PlanarBoard = CharucoBoard | Chessboard | AprilGrid


def _describe_length(length_mm: float, sigma_mm: LengthSigmas | None) -> str:
    """Return a length with its standard deviation where it is known."""
    if isinstance(sigma_mm, tuple):
        return f"{length_mm:g} mm ± {sigma_mm[0]:g} mm along rows, ± {sigma_mm[1]:g} mm along columns"
    return f"{length_mm:g} mm" + (f" ± {sigma_mm:g} mm" if sigma_mm else "")


def _square_corners_mm(grid: tuple[int, int], square_mm: float) -> NDArray[np.float64]:
    x, y = np.meshgrid(np.arange(1, grid[0] + 1), np.arange(1, grid[1] + 1))
    return np.stack([x.ravel(), y.ravel()], axis=-1).astype(np.float64) * square_mm
