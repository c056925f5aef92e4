"""The simulated calibration board: its texture and corners."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from beltscape.core.errors import SettingsError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.simulate.core_truth import compute_pixel_rays
from beltscape.simulate.ray_casting import RayScene
from beltscape.simulate.shapes import Mesh
from beltscape.simulate.solids.board import BLACK, WHITE, make_board_solid
from beltscape.target.board import CharucoBoard, Chessboard, corner_points_mm
from tests.optional import require

CHARUCO = CharucoBoard(squares=(11, 8), square_mm=34.0, marker_mm=25.0, dictionary="DICT_5X5_100")
EVEN = CharucoBoard(squares=(5, 4), square_mm=36.0, marker_mm=28.0, dictionary="DICT_5X5_100")
CHESS = Chessboard(corners=(9, 6), square_mm=25.0)
LENS = Camera(
    "cam0",
    (612, 512),
    np.array([580.0, 582.0]),
    np.array([309.0, 256.0]),
    np.array([-0.07, 0.09, 4e-4, -1e-4, 0]),
)
# world_from_board: above the belt, its print up; and the camera above it
BOARD_POSE = Pose.of([0.2, -0.15, 0.4], np.zeros(3)) @ Pose(
    np.diag([1.0, -1, -1]), np.array([-150.0, 120, 60])
)
CAMERA_POSE = Pose.of([0.03, 0.05, 0.1], np.zeros(3)) @ Pose(
    np.diag([1.0, -1, -1]), np.array([3.0, -5.0, 700.0])
)


def texel_at(solid, on_board_mm):
    """(N, 3) texture at places of the print, by the face they lie in: its uv is an affine map."""
    printed = solid.faces
    local = (solid.vertices_mm - BOARD_POSE.translation_mm) @ BOARD_POSE.rotation
    face = printed[(np.abs(local[printed][:, :, 2]) < 1e-9).all(axis=1)][0]
    affine = np.linalg.solve(np.column_stack([local[face][:, :2], np.ones(3)]), solid.uv[face])
    uv = np.column_stack([on_board_mm, np.ones(len(on_board_mm))]) @ affine
    height, width = solid.texture.shape[:2]
    at = np.floor(uv * [width, height] + 1e-9).astype(int)
    return solid.texture[at[:, 1], at[:, 0], 0], uv * [width, height]


@pytest.mark.parametrize("board", [CHARUCO, EVEN, CHESS])
def test_black_squares_touch_at_each_corner_on_a_corner_of_texels(board):
    solid = make_board_solid(board, BOARD_POSE)
    corners = corner_points_mm(board)[:, :2]
    _, texels = texel_at(solid, corners)
    np.testing.assert_allclose(texels, np.rint(texels), atol=1e-9)
    step = 0.05 * board.square_mm
    quarters = [
        texel_at(solid, corners + step * np.array(d))[0] for d in ([-1, -1], [1, -1], [1, 1], [-1, 1])
    ]
    first = np.array(quarters[0])
    column, row = np.rint(corners / board.square_mm).astype(int).T
    np.testing.assert_allclose(first, np.where((row + column) % 2 == 0, BLACK, WHITE), rtol=1e-6)
    np.testing.assert_array_equal(quarters[2], first)
    np.testing.assert_array_equal(quarters[1], quarters[3])
    assert (quarters[1] != first).all()


def test_texture_equals_the_drawing_of_opencv():
    texture = require(make_board_solid(EVEN, BOARD_POSE, margin_mm=0).texture)[..., 0]
    rows, columns = texture.shape
    theirs = EVEN.to_opencv(legacy=False).generateImage((columns, rows), marginSize=0, borderBits=1)
    assert set(np.unique(texture)) == {np.float32(BLACK), np.float32(WHITE)}  # bits end on whole texels
    assert ((texture > 0.5) == (theirs > 127)).mean() == 1.0


def test_bits_that_end_within_texels_keep_their_area():
    odd = CharucoBoard(squares=(5, 4), square_mm=30.0, marker_mm=21.37, dictionary="DICT_5X5_100")
    texture = require(make_board_solid(odd, BOARD_POSE, margin_mm=0).texture)[..., 0].astype(float)
    ink = ((WHITE - texture) / (WHITE - BLACK)).sum() * (150 / texture.shape[1]) ** 2
    theirs = odd.to_opencv(legacy=False)
    black = sum(
        (theirs.getDictionary().generateImageMarker(int(i), 7) == 0).sum() * (21.37 / 7) ** 2
        for i in theirs.getIds().ravel()
    )
    assert ink == pytest.approx(10 * 900 + black, rel=1e-6)


def test_opencv_detects_every_corner_at_its_position_in_a_traced_view():
    solid = make_board_solid(CHARUCO, BOARD_POSE)
    scene = RayScene([solid])
    rays = compute_pixel_rays(LENS, CAMERA_POSE, distorted=True)
    hits = scene.cast(CAMERA_POSE.center_mm, rays)
    met = np.isfinite(hits.distance)
    points = CAMERA_POSE.center_mm + hits.distance[met, None] * rays[met]
    on_board = (points - BOARD_POSE.translation_mm) @ BOARD_POSE.rotation
    np.testing.assert_allclose(
        on_board[:, 2], 0, atol=1e-9
    )  # the print looks at the camera: no back, no side
    image = np.full(len(rays), 120, np.uint8)
    image[met] = 255 * texel_at(solid, on_board[:, :2])[0]
    image = image.reshape(512, 612)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(CHARUCO.to_opencv(legacy=False)).detectBoard(image)
    assert corners is not None and ids is not None
    assert len(ids) == 70
    expected = LENS.project(CAMERA_POSE.apply(BOARD_POSE.apply(corner_points_mm(CHARUCO))))
    error = corners.reshape(-1, 2) - expected[ids.ravel()]
    assert np.sqrt((error**2).mean()) < 0.25  # the view has one ray a pixel
    assert np.abs(error.mean(axis=0)).max() < 0.05


@pytest.mark.parametrize("board", [CHARUCO, CHESS])
def test_ray_through_the_pixel_of_a_corner_hits_the_corner(board):
    corners = corner_points_mm(board)
    pixels = LENS.project(CAMERA_POSE.apply(BOARD_POSE.apply(corners)))
    theirs, _ = cv2.projectPoints(
        BOARD_POSE.apply(corners),
        CAMERA_POSE.rotation_vector,
        CAMERA_POSE.translation_mm,
        LENS.matrix,
        LENS.distortion,
    )
    np.testing.assert_allclose(pixels, theirs[:, 0], atol=1e-6)
    plane = LENS.undistort(pixels)
    rays = np.column_stack([plane, np.ones(len(plane))]) @ CAMERA_POSE.rotation
    hits = RayScene([make_board_solid(board, BOARD_POSE)]).cast(CAMERA_POSE.center_mm, rays)
    met = CAMERA_POSE.center_mm + hits.distance[:, None] * rays
    np.testing.assert_allclose(met, BOARD_POSE.apply(corners), rtol=0, atol=1e-6)


def test_plate_is_closed_and_as_large_as_board_and_margin():
    solid = make_board_solid(CHESS, Pose.identity(), margin_mm=20, thickness_mm=2)
    assert Mesh(solid.vertices_mm, solid.faces).volume_mm3 == pytest.approx(290 * 215 * 2, rel=0.01)
    welded = np.unique(np.round(solid.vertices_mm, 9), axis=0, return_inverse=True)[1].reshape(-1)
    assert Mesh(solid.vertices_mm, welded[solid.faces]).is_closed
    assert solid.vertices_mm[:, 2].min() == 0
    uv = require(solid.uv)
    assert (uv.min(), uv.max()) == (0, 1)


def test_inverted_board_is_its_negative_and_a_legacy_one_is_refused():
    plain = require(make_board_solid(EVEN, BOARD_POSE).texture)
    turned = require(make_board_solid(EVEN.model_copy(update={"inverted": True}), BOARD_POSE).texture)
    np.testing.assert_allclose(plain + turned, WHITE + BLACK, rtol=1e-6)
    with pytest.raises(SettingsError, match="legacy"):
        make_board_solid(EVEN.model_copy(update={"legacy": True}), BOARD_POSE)
