"""The targets: a calibration board as a thin plate with a printed texture, and the module as solids on a plate."""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache
from math import ceil, floor, lcm

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import SettingsError
from beltscape.core.geometry.pose import Pose
from beltscape.simulate.shapes import Mesh, make_box, make_cylinder, make_sphere
from beltscape.simulate.world import Label, Solid
from beltscape.target.module import Cube, Cylinder, Feature, Module
from beltscape.target.planar_boards import CharucoBoard, SquareBoard
from beltscape.target.print_board import black_squares

WHITE, BLACK = 0.8, 0.04
"""Reflectance of paper and of ink."""
_TEXELS = (64, 200)
"""Texels per square: the minimum, and the maximum that aligns marker bits with whole texels."""


def make_board_solid(
    board: SquareBoard, world_from_board: Pose, *, margin_mm: float | None = None, thickness_mm: float = 3.0
) -> Solid:
    """Return the board at its pose; the printed side is z = 0 of the board's frame and faces −z.

    The board's frame is OpenCV's: x to the right and y down on the print, z into the plate, away from the viewer.
    Corner (i, j) of the print lies exactly where `corner_points_mm` puts it. The margin is white (black where the
    board is inverted), one square wide unless given, rounded up to whole texels; back and sides have its colour.

    Raises
    ------
    SettingsError
        If the board has OpenCV's legacy arrangement, which is not simulated.
    """
    texture, texel_mm, margin_mm = make_print_texture(
        board, board.square_mm if margin_mm is None else margin_mm
    )
    height, width = texture.shape[:2]
    plate = make_box([width * texel_mm, height * texel_mm, thickness_mm])
    columns, rows = board.grid
    middle = np.array([columns + 1, rows + 1]) * board.square_mm / 2
    on_board = plate.vertices_mm + np.array([*middle, 0.0])
    # the printed face has separate vertices: the other faces show the margin's first texel
    printed = (on_board[plate.faces][:, :, 2] == 0).all(axis=1)
    vertices = np.concatenate([on_board, on_board])
    faces = np.where(printed[:, None], plate.faces, plate.faces + len(on_board))
    uv = (on_board[:, :2] + margin_mm) / ([width * texel_mm, height * texel_mm])
    blank = np.tile([0.5 / width, 0.5 / height], (len(on_board), 1))
    return Solid(
        name="board",
        label=Label.BOARD,
        vertices_mm=world_from_board.apply(vertices),
        faces=faces,
        reflectance=(1.0, 1.0, 1.0),
        texture=texture,
        uv=np.concatenate([uv, blank]),
    )


@lru_cache(maxsize=4)
def make_print_texture(board: SquareBoard, margin_mm: float) -> tuple[NDArray[np.float32], float, float]:
    """Return (h, w, 3) reflectance of the printed side, the edge of a texel, and the margin in whole texels, mm."""
    legacy, inverted = getattr(board, "legacy", None), getattr(board, "inverted", None)
    if legacy:
        raise SettingsError("legacy = true: a legacy board is not simulated; set legacy = false")
    texels = _texels_per_square(board)
    texel_mm = board.square_mm / texels
    margin = ceil(margin_mm / texel_mm - 1e-9)
    columns, rows = board.grid
    ink = np.zeros(((rows + 1) * texels, (columns + 1) * texels))
    for x, y, width, height in black_squares(board) / texel_mm:
        (rows, down), (across, right) = _cover_texels(y, height), _cover_texels(x, width)
        ink[rows, across] += np.outer(down, right)
    ink = np.pad(ink.clip(0, 1), margin)
    if inverted:
        ink = 1 - ink
    texture = np.repeat((WHITE + (BLACK - WHITE) * ink)[..., None], 3, axis=2).astype(np.float32)
    texture.setflags(write=False)
    return texture, texel_mm, margin * texel_mm


def _cover_texels(start: float, length: float) -> tuple[slice, NDArray[np.float64]]:
    """Return the texels of [start, start + length] and the share of each that it covers.

    Edges between texels stay exact.
    """
    first, last = floor(start + 1e-9), ceil(start + length - 1e-9)
    covered = np.diff(np.clip(np.arange(first, last + 1.0), start, start + length))
    return slice(first, last), np.where(np.abs(covered - np.rint(covered)) < 1e-9, np.rint(covered), covered)


def _texels_per_square(board: SquareBoard) -> int:
    """Return a number of texels for which squares, and where possible marker bits, end on whole texels."""
    low, high = _TEXELS
    if not isinstance(board, CharucoBoard):
        return low
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    marker = Fraction(str(board.marker_mm)) / Fraction(str(board.square_mm))
    whole = lcm(((1 - marker) / 2).denominator, (marker / (dictionary.markerSize + 2)).denominator)
    return whole * ceil(low / whole) if whole * ceil(low / whole) <= high else 128


def place_module(
    module: Module, x_mm: float = 0.0, y_mm: float = 0.0, turn_deg: float = 0.0, belt_mm: float = 0.0
) -> Pose:
    """Return world_from_module of a module on the level belt at height ``belt_mm``, rotated about z."""
    turn = Pose.of([0.0, 0.0, np.deg2rad(turn_deg)], np.zeros(3)).rotation
    return Pose(turn, np.array([x_mm, y_mm, belt_mm + module.base.size_mm[2]]))


def make_module_solids(
    module: Module, world_from_module: Pose, reflectance: float = 0.55
) -> tuple[Solid, ...]:
    """Return the base, then the features in the order of `Module.features`, labelled BASE, FEATURE, FEATURE + 1, ….

    Round shapes are meshes within 0.003 mm of the exact ones.
    """
    base = make_box(module.base.size_mm)
    below_origin = Pose(np.eye(3), np.array([0.0, 0.0, -module.base.size_mm[2]]))
    parts = [("base", int(Label.BASE), base.transform(below_origin))]
    parts += [
        (feature.name, Label.FEATURE + i, _make_feature_mesh(feature))
        for i, feature in enumerate(module.features)
    ]
    return tuple(
        Solid(
            name,
            label,
            world_from_module.apply(mesh.vertices_mm),
            mesh.faces,
            (reflectance, reflectance, reflectance),
        )
        for name, label, mesh in parts
    )


def _make_feature_mesh(feature: Feature) -> Mesh:
    """Return a feature's mesh at its position on the module's base."""
    lift = 0.0
    if isinstance(feature, Cube):
        mesh = make_box([feature.edge_mm] * 3)
    elif isinstance(feature, Cylinder):
        mesh = make_cylinder(feature.diameter_mm / 2, feature.height_mm)
    else:
        mesh, lift = make_sphere(feature.diameter_mm / 2), feature.diameter_mm / 2
    return mesh.transform(Pose(np.eye(3), np.array([*feature.center_mm, lift])))
