"""Several planar boards in one view: the faces of one rigid object, or boards that move independently."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, model_validator

from beltscape.core.geometry.pose import Pose
from beltscape.target.planar_boards import AprilGrid, CharucoBoard, Chessboard, PlanarBoard

MAX_AXIS_ERROR = 1e-3
"""Deviation of two axes from unit length and from a right angle up to which rounded numbers explain it."""

Vector = tuple[float, float, float]


class Placement(BaseModel, frozen=True, extra="forbid"):
    """Place of a board on the object: its first square's outer corner, and the directions of its rows and columns."""

    if TYPE_CHECKING:

        def __hash__(self) -> int: ...  # pydantic adds it to a frozen model

    origin_mm: Vector
    x_axis: Vector
    """Direction from column to column, in the object's frame."""
    y_axis: Vector
    """Direction from row to row, in the object's frame."""

    @model_validator(mode="after")
    def _check_axes(self) -> Placement:
        x, y = np.array(self.x_axis), np.array(self.y_axis)
        errors = np.abs([np.linalg.norm(x) - 1, np.linalg.norm(y) - 1, x @ y])
        if not errors.max() < MAX_AXIS_ERROR:
            raise ValueError(
                f"x_axis = {list(self.x_axis)} and y_axis = {list(self.y_axis)} must have length 1 and a right angle "
                "between them"
            )
        return self

    def to_pose(self) -> Pose:
        """Return object_from_board."""
        x = np.array(self.x_axis) / np.linalg.norm(self.x_axis)
        y = np.array(self.y_axis) - (np.array(self.y_axis) @ x) * x
        y /= np.linalg.norm(y)
        return Pose(np.column_stack([x, y, np.cross(x, y)]), np.array(self.origin_mm, np.float64))

    @classmethod
    def from_pose(cls, object_from_board: Pose) -> Placement:
        """Return the placement of a pose."""
        x, y, _ = object_from_board.rotation.T.tolist()
        return cls(origin_mm=object_from_board.translation_mm.tolist(), x_axis=x, y_axis=y)


class BoardFace(BaseModel, frozen=True, extra="forbid"):
    """One board of a set."""

    if TYPE_CHECKING:

        def __hash__(self) -> int: ...  # pydantic adds it to a frozen model

    name: Annotated[str, Field(min_length=1)]
    board: Annotated[CharucoBoard | Chessboard | AprilGrid, Field(discriminator="kind")]
    placement: Placement | None = None
    """None: estimated from the views."""
    is_estimated: bool = False
    """Whether the placement follows from the views, so that the joint adjustment leaves it free."""
    from_behind: bool = False
    """Whether it is the print on the back of the first board, with the same ids: its own frame is the front's, as if
    the sheet were transparent."""


class BoardSet(BaseModel, frozen=True, extra="forbid"):
    """Several planar boards; corners are numbered through all of them, in the order of the boards."""

    if TYPE_CHECKING:

        def __hash__(self) -> int: ...  # pydantic adds it to a frozen model

    kind: Literal["boards"] = "boards"
    rigid: bool = True
    """Whether the boards are fixed to each other: the faces of a cube, or several sheets on one plate."""
    faces: Annotated[tuple[BoardFace, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _check_faces(self) -> BoardSet:
        names = [face.name for face in self.faces]
        for i, face in enumerate(self.faces):
            if face.name in names[:i]:
                raise ValueError(f"two boards are called {face.name!r}; give each a name of its own")
            if isinstance(face.board, Chessboard) and len(self.faces) > 1:
                raise ValueError(
                    f"board {face.name}: a chessboard has no ids, so that it cannot be told from another one; use "
                    "ChArUco boards or AprilGrids"
                )
            for other in self.faces[:i]:
                _require_separate_ids(other, face)
            if face.placement is not None and not self.rigid:
                raise ValueError(f"board {face.name}: has a place, but rigid = false; leave one of them out")
        return self

    @property
    def is_two_sided(self) -> bool:
        """True if the set is one sheet with the same print on both sides."""
        return self.faces[-1].from_behind

    @property
    def is_placed(self) -> bool:
        """True if the places of all boards are known."""
        return all(face.placement is not None for face in self.faces)

    @property
    def square_mm(self) -> float:
        """Return the square of the first board."""
        return self.faces[0].board.square_mm

    @property
    def scale_sigma(self) -> float:
        """Return the relative standard deviation of the boards' size, the largest one: they are printed alike."""
        return max(face.board.scale_sigma for face in self.faces)

    @property
    def offsets(self) -> tuple[int, ...]:
        """Return the number of the first corner of each board, and the number of all corners."""
        counts = [face.board.grid[0] * face.board.grid[1] for face in self.faces]
        return tuple(np.concatenate([[0], np.cumsum(counts)]).tolist())

    def corners_mm(self) -> NDArray[np.float64]:
        """Return all corners (P, 3), mm: on the object, or each in its own board's frame where no place is known."""
        return np.concatenate([_place_corners(face) for face in self.faces])

    def unplace(self) -> BoardSet:
        """Return the set with every board in its own frame, where all its corners have z = 0."""
        faces = tuple(face.model_copy(update={"placement": None}) for face in self.faces)
        return self.model_copy(update={"faces": faces})

    def place(self, poses: dict[str, Pose]) -> BoardSet:
        """Return the set with boards placed at poses object_from_board, by name."""
        faces = [
            face.model_copy(update={"placement": Placement.from_pose(poses[face.name])})
            if face.name in poses
            else face
            for face in self.faces
        ]
        return self.model_copy(update={"faces": tuple(faces)})

    def place_by_views(self, poses: dict[str, Pose]) -> BoardSet:
        """Return the set with boards placed at estimated poses object_from_board, by name."""
        faces = [
            face.model_copy(update={"is_estimated": True}) if face.name in poses else face
            for face in self.place(poses).faces
        ]
        return self.model_copy(update={"faces": tuple(faces)})

    def list_loose_corners(self) -> tuple[slice, ...]:
        """Return the corners of each board whose place is estimated against the others, or else the first one."""
        estimated = [number for number, face in enumerate(self.faces) if face.is_estimated]
        loose = estimated[1:] if len(estimated) == len(self.faces) else estimated
        return tuple(slice(self.offsets[number], self.offsets[number + 1]) for number in loose)

    def describe(self) -> str:
        """Describe the boards in a few words."""
        if self.is_two_sided:
            return f"{self.faces[0].board.describe()}, on both sides"
        how = "fixed to each other" if self.rigid else "independent"
        return f"{len(self.faces)} boards, {how}: " + "; ".join(
            f"{face.name}, {face.board.describe()}" for face in self.faces
        )


def _place_corners(face: BoardFace) -> NDArray[np.float64]:
    corners = face.board.corners_mm()
    corners = np.column_stack([corners, np.zeros(len(corners))])
    return corners if face.placement is None else face.placement.to_pose().apply(corners)


def _require_separate_ids(first: BoardFace, second: BoardFace) -> None:
    a, b = _list_markers(first.board), _list_markers(second.board)
    if (
        first.from_behind == second.from_behind
        and a[0] == b[0]
        and max(a[1].start, b[1].start) < min(a[1].stop, b[1].stop)
    ):
        raise ValueError(
            f"boards {first.name} and {second.name} share marker ids ({a[1].start} to {a[1].stop - 1}, "
            f"{b[1].start} to {b[1].stop - 1}); give each its own first_id"
        )


def _list_markers(board: PlanarBoard) -> tuple[str, range]:
    return ("", range(0)) if isinstance(board, Chessboard) else (board.dictionary, board.marker_ids)
