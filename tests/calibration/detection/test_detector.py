"""Detection of ChArUco and chessboard corners in rendered images: accuracy and numbering."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from beltscape.calibration.detection.detector import (
    PrintVariant,
    add_back_side,
    convert_to_8_bit,
    find_chessboard,
    make_detector,
)
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.target.board import AprilGrid, Board, BoardSet, CharucoBoard, Chessboard, corner_points_mm
from tests.synthetic.boards import Print, camera, facing, view
from tests.thorough import list_cases

CHARUCO = CharucoBoard(squares=(8, 6), square_mm=40, marker_mm=29, dictionary="DICT_4X4_50")
CHESSBOARD = Chessboard(corners=(8, 5), square_mm=40)
SHIFTED = CharucoBoard(squares=(8, 6), square_mm=40, marker_mm=29, dictionary="DICT_4X4_100", first_id=37)
APRILGRID = AprilGrid(tags=(4, 3), tag_mm=60, spacing=0.25, first_id=7)
LENS = camera("a")


def truth(board: Board, pose: Pose) -> np.ndarray:
    return LENS.project(pose.apply(corner_points_mm(board)))


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("tilt", [0.0, 0.5])
def test_charuco_corners_are_detected_accurately(legacy, inverted, tilt):
    pose = facing(CHARUCO, tilt=tilt)
    corners = make_detector(CHARUCO, PrintVariant(legacy, inverted))(
        view(LENS, pose, CHARUCO, Print(legacy, inverted))
    )
    assert corners is not None
    assert corners.ids.tolist() == list(range(35))
    errors = corners.pixels - truth(CHARUCO, pose)
    assert np.sqrt((errors**2).mean()) < 0.02
    assert np.abs(errors.mean(axis=0)).max() < 0.01  # no shift by a fraction of a pixel


@pytest.mark.parametrize("tilt", [0.0, 0.5])
def test_chessboard_corners_are_detected_accurately(tilt):
    pose = facing(CHESSBOARD, tilt=tilt)
    corners = make_detector(CHESSBOARD, PrintVariant())(view(LENS, pose, CHESSBOARD))
    assert corners is not None
    errors = corners.pixels - truth(CHESSBOARD, pose)
    assert np.sqrt((errors**2).mean()) < 0.02
    assert np.abs(errors.mean(axis=0)).max() < 0.01


@pytest.mark.parametrize("roll_deg", [0, 90, 180, 270])
def test_a_chessboard_is_numbered_from_the_same_end_however_the_camera_is_mounted(roll_deg):
    pose = facing(CHESSBOARD, roll=np.deg2rad(roll_deg))
    corners = make_detector(CHESSBOARD, PrintVariant())(view(LENS, pose, CHESSBOARD))
    assert corners is not None
    np.testing.assert_allclose(corners.pixels, truth(CHESSBOARD, pose), atol=0.3)


def test_the_order_of_a_symmetric_chessboard_is_unchanged():
    board = Chessboard(corners=(7, 5), square_mm=40)
    pose = facing(board)
    corners = find_chessboard(view(LENS, pose, board), board.corners)
    assert corners is not None
    both = [truth(board, pose), truth(board, pose)[::-1]]
    assert min(np.abs(corners.pixels - pixels).max() for pixels in both) < 0.3


def test_part_of_a_charuco_board_keeps_its_ids():
    pose = facing(CHARUCO, distance_mm=420)
    image = view(LENS, pose, CHARUCO)
    image[:, :200] = 128
    corners = make_detector(CHARUCO, PrintVariant())(image)
    assert corners is not None
    assert 8 <= len(corners) < 35
    assert (np.diff(corners.ids) > 0).all()
    np.testing.assert_allclose(corners.pixels, truth(CHARUCO, pose)[corners.ids], atol=0.6)


@pytest.mark.parametrize("board", list_cases([CHARUCO, CHESSBOARD], [CHARUCO]), ids=["charuco", "chessboard"])
def test_an_image_without_the_board_gives_nothing(board):
    noise = np.random.default_rng(0).integers(0, 255, (100, 120)).astype(np.uint8)
    grey = np.full((400, 480), 128, np.uint8)
    other = CHESSBOARD if board is CHARUCO else CHARUCO
    for image in (noise, grey, view(LENS, facing(other), other)):
        assert make_detector(board, PrintVariant())(image) is None


def test_one_row_of_corners_is_not_enough():
    """Corners on a line do not fix a pose."""
    pose = facing(CHARUCO, tilt=0.0)
    image = view(LENS, pose, CHARUCO)
    rows = truth(CHARUCO, pose).reshape(5, 7, 2)[..., 1]
    image[int(rows[0].max() + rows[1].min()) // 2 + 22 :] = 128
    assert make_detector(CHARUCO, PrintVariant())(image) is None


def test_a_wrong_print_variant_is_not_detected():
    image = view(LENS, facing(CHARUCO), CHARUCO, Print(inverted=True))
    assert make_detector(CHARUCO, PrintVariant(inverted=False))(image) is None
    legacy = view(LENS, facing(CHARUCO), CHARUCO, Print(legacy=True))
    assert make_detector(CHARUCO, PrintVariant(legacy=False))(legacy) is None


def test_colour_and_16_bit_views_give_the_same_corners():
    image = view(LENS, facing(CHARUCO), CHARUCO)
    plain = make_detector(CHARUCO, PrintVariant())(image)
    rgb = make_detector(CHARUCO, PrintVariant())(convert_to_8_bit(np.repeat(image[..., None], 3, axis=2)))
    deep = make_detector(CHARUCO, PrintVariant())(
        convert_to_8_bit(image.astype(np.uint16) * 16)
    )  # a 12-bit camera
    assert plain is not None
    assert rgb is not None
    assert deep is not None
    np.testing.assert_allclose(rgb.pixels, plain.pixels, atol=0.01)
    np.testing.assert_array_equal(deep.ids, plain.ids)
    np.testing.assert_allclose(deep.pixels, plain.pixels, atol=0.05)


def test_a_black_16_bit_image_is_black():
    assert convert_to_8_bit(np.zeros((4, 4), np.uint16)).tolist() == np.zeros((4, 4)).tolist()


def test_detection_does_not_change_the_image():
    image = view(LENS, facing(CHARUCO), CHARUCO, Print(inverted=True))
    before = image.copy()
    make_detector(CHARUCO, PrintVariant(inverted=True))(image)
    np.testing.assert_array_equal(image, before)


def test_the_renderer_draws_what_opencv_projects():
    """The rendered corners agree with OpenCV's projection."""
    pose = facing(CHARUCO, tilt=0.4)
    turn, _ = cv2.Rodrigues(pose.rotation)
    expected, _ = cv2.projectPoints(
        corner_points_mm(CHARUCO), turn, pose.translation_mm, LENS.matrix, LENS.distortion
    )
    np.testing.assert_allclose(truth(CHARUCO, pose), expected.reshape(-1, 2), atol=1e-8)


def test_a_chessboard_is_numbered_from_its_front():
    from beltscape.calibration.detection.detector import _orient_rows

    columns, rows = np.meshgrid(np.arange(4.0), np.arange(3.0))
    front = np.stack([10 * columns, 10 * rows], axis=-1)
    np.testing.assert_array_equal(_orient_rows(front.reshape(-1, 2), (4, 3)), front.reshape(-1, 2))
    mirrored = front[:, ::-1].reshape(-1, 2)
    np.testing.assert_array_equal(_orient_rows(mirrored, (4, 3)), front.reshape(-1, 2))


def test_a_charuco_board_may_begin_with_any_marker():
    pose = facing(SHIFTED)
    image = view(LENS, pose, SHIFTED)
    corners = make_detector(SHIFTED, PrintVariant())(image)
    assert corners is not None
    assert corners.ids.tolist() == list(range(35))
    np.testing.assert_allclose(corners.pixels, truth(SHIFTED, pose), atol=0.1)
    other = SHIFTED.model_copy(update={"first_id": 5})
    assert make_detector(other, PrintVariant())(image) is None


def test_tags_of_a_fisheye_image_keep_their_corners():
    """Where the centres of twelve tags place them, 129 are found, some of them 9 px off; none may be off."""
    board, found = AprilGrid(tags=(6, 6), tag_mm=30, spacing=0.25), 0
    lens = Camera(
        "fish", (800, 660), np.full(2, 300.0), np.array([404.0, 327.0]), np.array([0.02, -0.01, 0.003, -0.001]),
        "fisheye",
    )  # fmt: skip
    middle = corner_points_mm(board).mean(axis=0)
    for seed in (1, 3, 4, 5):
        rng = np.random.default_rng(seed)
        turn = Pose.of([*rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.3, 0.3)], np.zeros(3)).rotation
        pose = Pose.placing(turn, middle, rng.uniform([-150, -110, 120], [150, 110, 200]))
        corners = make_detector(board, PrintVariant(False, False))(view(lens, pose, board, Print(seed=seed)))
        assert corners is not None
        true = lens.project(pose.apply(corner_points_mm(board)))[corners.ids]
        assert np.linalg.norm(corners.pixels - true, axis=1).max() < 0.2
        found += len(corners)
    assert found > 190


@pytest.mark.parametrize("tilt", [0.2, 0.6])
@pytest.mark.parametrize("roll_deg", [0, 120])
def test_an_aprilgrid_is_detected_accurately(tilt, roll_deg):
    pose = facing_april(tilt, np.deg2rad(roll_deg))
    corners = make_detector(APRILGRID, PrintVariant())(view(LENS, pose, APRILGRID))
    assert corners is not None
    assert len(corners) >= 44
    errors = corners.pixels - truth(APRILGRID, pose)[corners.ids]
    assert np.sqrt((errors**2).mean()) < 0.04


def facing_april(tilt: float, roll: float = 0.0) -> Pose:
    turn = Pose.of([0, 0, roll], [0, 0, 0]) @ Pose.of([tilt, tilt / 2, 0], [0, 0, 0])
    middle = corner_points_mm(APRILGRID).mean(axis=0)
    return Pose(turn.rotation, np.array([0, 0, 520.0]) - turn.rotation @ middle)


def test_a_board_is_found_from_behind_with_the_ids_of_its_front():
    pose = facing(CHARUCO, tilt=0.3)
    mirrored = np.ascontiguousarray(view(LENS, pose, CHARUCO)[:, ::-1])
    detect = make_detector(CHARUCO, PrintVariant())
    assert detect(mirrored) is None
    corners = add_back_side(detect)(mirrored)
    assert corners is not None
    assert corners.from_behind
    expected = truth(CHARUCO, pose) * [-1, 1] + [LENS.size_px[0] - 1, 0]
    np.testing.assert_allclose(corners.pixels, expected[corners.ids], atol=0.1)
    front = add_back_side(detect)(mirrored[:, ::-1])
    assert front is not None
    assert not front.from_behind


def test_boards_of_a_set_are_numbered_through():
    faces = [{"name": "first", "board": CHARUCO}, {"name": "second", "board": SHIFTED}]
    boards = BoardSet.model_validate({"rigid": False, "faces": faces})
    pose = facing(SHIFTED)
    corners = make_detector(boards, PrintVariant())(view(LENS, pose, SHIFTED))
    assert corners is not None
    # ids 0 to 34 are those of the first board
    assert corners.ids.tolist() == list(range(35, 70))


def draw_large_board(shade: float, noise: float, tilt_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the image (640, 800) of a board of 28×17 corners in light that falls to ``shade``, and its corners."""
    dark = np.indices((18, 29)).sum(axis=0) % 2 == 0
    texture = np.pad(np.kron(np.where(dark, 0.3, 1.0), np.ones((24, 24))), 24, constant_values=1.0)
    height, width = texture.shape
    sheet = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    image_of_sheet = np.array([[60, 50], [740, 50 + tilt_px], [710, 580 - tilt_px], [90, 560]], np.float32)
    homography = cv2.getPerspectiveTransform(sheet, image_of_sheet)
    smooth = cv2.GaussianBlur(texture.astype(np.float32), (0, 0), 1.0)
    image = cv2.warpPerspective(smooth, homography, (800, 640), flags=cv2.INTER_AREA, borderValue=0.5)
    light = shade + (1 - shade) * (1 - np.linspace(0, 1, 800)) ** 2
    image = cv2.GaussianBlur(image, (0, 0), 0.8) * light * 220 + 8
    image += np.random.default_rng(1).normal(0, noise, image.shape)
    on_sheet = (
        np.stack(np.meshgrid(np.arange(1, 29), np.arange(1, 18)), axis=-1).reshape(-1, 1, 2) * 24 + 23.5
    )
    corners = cv2.perspectiveTransform(on_sheet, homography)[:, 0]
    return np.clip(image, 0, 255).astype(np.uint8), corners


@pytest.mark.parametrize(("shade", "noise", "tilt_px"), [(0.06, 3.0, 20.0), (0.5, 2.0, 0.0)])
def test_a_large_chessboard_in_uneven_light_is_detected(shade, noise, tilt_px):
    image, expected = draw_large_board(shade, noise, tilt_px)
    corners = find_chessboard(image, (28, 17))
    assert corners is not None
    np.testing.assert_allclose(corners.pixels, expected, atol=3.0)
