"""Sets of boards: the faces of a cube with unknown places, boards that move by themselves, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.core.errors import CalibrationError, InputError
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.pipeline.calibrating.board_sets import resolve_board_set
from beltscape.pipeline.calibrating.intrinsics import KnownIntrinsics
from beltscape.target.board import BoardSet, corner_points_mm, parse_board
from tests.synthetic.boards import row_of_cameras

EDGE_MM = 180.0
PLACES = {
    "front": Pose.identity(),
    "right": Pose(np.array([[0, 0, -1.0], [0, 1, 0], [1, 0, 0]]), np.array([EDGE_MM, 0, 0])),
    "bottom": Pose(np.array([[1, 0, 0.0], [0, 0, -1], [0, 1, 0]]), np.array([0, EDGE_MM, 0])),
}
FACE = {"kind": "charuco", "squares": [6, 6], "square_mm": 30, "marker_mm": 22, "dictionary": "DICT_5X5_250"}
TABLES = [{"name": name, **FACE, "first_id": 18 * k} for k, name in enumerate(PLACES)]
NOISE_PX = 0.1


def parse(tables: list[Any], **keys: object) -> BoardSet:
    board = parse_board(Path("board.toml"), {"boards": tables, **keys})
    assert isinstance(board, BoardSet)
    return board


def detect_cube(rig: Rig, frames: int, only: tuple[str, ...] = tuple(PLACES)) -> BoardDetections:
    """Return the corners of the cube's faces that are turned towards each camera and inside its image."""
    rng = np.random.default_rng(0)
    cube = parse(TABLES).place(PLACES)
    views: dict[str, dict[str, Corners]] = {name: {} for name in rig.cameras}
    for i in range(frames):
        rotation = Pose.of([*rng.uniform([-0.9, 0.1, -0.4], [-0.1, 0.9, 0.4])], np.zeros(3)).rotation
        middle = rng.uniform([0, -50, 650], [120, 50, 850])
        pose = Pose(rotation, middle - rotation @ np.array([90, 90, 60.0]))
        for name, camera in rig.cameras.items():
            cam_from_object = rig.cam_from_core[name] @ pose
            pixels = camera.project(cam_from_object.apply(corner_points_mm(cube)))
            seen = [
                np.arange(cube.offsets[k], cube.offsets[k + 1])
                for k, face in enumerate(PLACES)
                if face in only and is_visible(cam_from_object @ PLACES[face])
            ]
            ids = np.concatenate([*seen, np.empty(0, np.int64)]).astype(np.int64)
            if len(ids) and ((pixels[ids] > 4) & (pixels[ids] < np.array(camera.size_px) - 4)).all():
                views[name][f"{i:02d}"] = Corners(ids, pixels[ids] + rng.normal(0, NOISE_PX, (len(ids), 2)))
    sizes = {name: camera.size_px for name, camera in rig.cameras.items()}
    return BoardDetections(sizes, views, dict.fromkeys(rig.cameras, frames))


def is_visible(cam_from_board: Pose) -> bool:
    middle = cam_from_board.apply(np.array([[90.0, 90.0, 0.0]]))[0]
    return bool(cam_from_board.rotation[:, 2] @ middle > 0.3 * np.linalg.norm(middle))


RIG = row_of_cameras(["a", "b", "c"])


@pytest.fixture(scope="module")
def detections():
    return detect_cube(RIG, 14)


def test_the_places_of_a_cubes_faces_are_estimated(detections):
    own, board, start = resolve_board_set(detections, parse(TABLES), KnownIntrinsics({}))
    assert isinstance(board, BoardSet)
    apart = corner_points_mm(board) - corner_points_mm(parse(TABLES).place(PLACES))
    assert np.sqrt((apart**2).sum(axis=1).mean()) < 0.1
    hierarchy = solve_hierarchy(own, board, "a", Silent(), known=start.cameras, priors=start.priors)
    rig = adjust_bundle(hierarchy, board).rig
    for name, camera in RIG.cameras.items():
        assert np.abs(rig.cameras[name].focal_px - camera.focal_px).max() < 1.5
        assert np.linalg.norm(rig.cam_from_core[name].center_mm - RIG.cam_from_core[name].center_mm) < 1.0


def test_given_places_are_kept(detections):
    axes = [{"origin_mm": p.translation_mm.tolist(), "x_axis": p.rotation[:, 0].tolist(),
             "y_axis": p.rotation[:, 1].tolist()} for p in PLACES.values()]  # fmt: skip
    tables = [{**table, **axis} for table, axis in zip(TABLES, axes, strict=True)]
    _, board, start = resolve_board_set(detections, parse(tables), KnownIntrinsics(RIG.cameras))
    np.testing.assert_allclose(
        corner_points_mm(board), corner_points_mm(parse(TABLES).place(PLACES)), atol=1e-12
    )
    assert start.priors == {}  # known lenses stay known


def test_independent_boards_are_views_of_their_own(detections):
    own, board, _ = resolve_board_set(detections, parse(TABLES, rigid=False), KnownIntrinsics({}))
    assert {frame.split("/")[1] for frame in own.frames} == set(PLACES)
    rig = adjust_bundle(solve_hierarchy(own, board, "a", Silent()), board).rig
    for name in RIG.cameras:
        assert np.linalg.norm(rig.cam_from_core[name].center_mm - RIG.cam_from_core[name].center_mm) < 1.0


def test_a_face_that_is_never_seen_with_another_is_named():
    seen = detect_cube(RIG, 6, only=("front", "right"))
    with pytest.raises(
        CalibrationError, match="boards bottom: no image shows them together with another board"
    ):
        resolve_board_set(seen, parse(TABLES), KnownIntrinsics(RIG.cameras))


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (
            {"first_id": 3},
            "boards front and right share marker ids (0 to 17, 3 to 20); give each its own first_id",
        ),
        ({"name": "front"}, "two boards are called 'front'"),
        (
            {"origin_mm": [0, 0, 0], "x_axis": [1, 0, 0], "y_axis": [1, 0, 0]},
            "must have length 1 and a right angle",
        ),
        ({"kind": "x"}, "board.toml: boards[1]: kind = 'x': must be"),
        ({"square": 3}, "board.toml: boards[1]: unknown key square; did you mean squares?"),
    ],
)
def test_an_impossible_set_is_refused(change, line):
    with pytest.raises(InputError) as error:
        parse([TABLES[0], {**TABLES[1], **change}])
    assert line in str(error.value)
