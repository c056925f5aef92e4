"""A bad input is one line on standard error with file, value and fix."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from beltscape.files.images import KINDS, write_image
from beltscape.files.rig_json import write_rig
from beltscape.target.board import Chessboard
from tests.cli.conftest import BOARD
from tests.synthetic.boards import BoardCapture, board_poses, capture, row_of_cameras

CHESSBOARD = 'kind = "chessboard"\ncorners = [8, 5]\nsquare_mm = 40\n'
NOT_SHOWN = "capture: no image shows the board (ChArUco {}, square 40 mm)"
pytestmark = pytest.mark.usefixtures("desk")


@pytest.fixture(scope="session")
def chessboard_capture(tmp_path_factory) -> BoardCapture:
    board = Chessboard(corners=(8, 5), square_mm=40)
    rig = row_of_cameras(["left", "right"])
    return capture(tmp_path_factory.mktemp("chessboard"), rig, board, board_poses(board, 1))


@pytest.fixture
def two_images(desk) -> None:
    """Only one frame is left: enough to see that it is another board, and quicker."""
    for path in (desk / "capture").glob("*/*.png"):
        if path.stem > "00":
            path.unlink()


def rename_camera(old: str, new: str) -> None:
    Path("capture", old).rename(Path("capture", new))


def test_a_missing_capture_folder(calibrate):
    assert calibrate(capture="nowhere") == (
        2, ["beltscape: nowhere: no such folder; a capture is <capture>/<camera>/<frame>.png"],
    )  # fmt: skip


def test_an_empty_capture_folder(calibrate):
    Path("empty").mkdir()
    assert calibrate(capture="empty") == (
        2,
        ["beltscape: empty: no camera folder with images in it; a capture is <capture>/<camera>/<frame>.png"],
    )


def test_one_camera_only(calibrate):
    shutil.rmtree("capture/cam1")
    assert calibrate() == (
        2,
        [
            "beltscape: capture: only camera cam0 has images; a rig needs two: "
            "give the folder above the camera folders"
        ],
    )


def test_a_core_that_is_not_in_the_capture(calibrate):
    assert calibrate("--core", "cam9") == (2, ["beltscape: capture: no camera cam9 in it; it has cam0, cam1"])


def test_no_readable_image_at_all(calibrate):
    for path in Path("capture").glob("*/*.png"):
        path.write_text("not an image")
    code, lines = calibrate()
    assert (code, lines[-1]) == (
        2, "beltscape: capture: none of its 10 images can be read; the first: "
        f"capture/cam0/00.png: not a readable image; {KINDS} are known",
    )  # fmt: skip


def test_a_core_without_a_readable_image(calibrate, charuco_capture):
    shutil.copytree(charuco_capture.folder / "cam2", "capture/cam2")
    for path in Path("capture/cam1").iterdir():
        path.write_bytes(b"")
    code, lines = calibrate("--core", "cam1")
    assert (code, lines[-1]) == (
        2, "beltscape: core camera cam1 has no usable image: choose another with --core",
    )  # fmt: skip
    assert lines[-2] == "warning: capture/cam1: none of its images can be read; going on without cam1"


@pytest.mark.parametrize(
    ("change", "board", "shown"),
    [
        pytest.param(
            ("4X4_50", "5X5_100"),
            "8×6, DICT_5X5_100",
            "they show markers DICT_4X4_50 with ids up to 23 on a board of 8 columns",
            marks=pytest.mark.thorough,
        ),
        (
            ("[8, 6]", "[9, 6]"),
            "9×6, DICT_4X4_50",
            "they show markers DICT_4X4_50 with ids up to 23 on a board of 8 columns",
        ),
        (
            ("[8, 6]", "[6, 8]"),
            "6×8, DICT_4X4_50",
            "the markers fit squares = [8, 6]",
        ),
    ],
    ids=["dictionary", "squares", "squares the other way round"],
)
def test_a_board_toml_of_another_charuco_board(calibrate, two_images, change, board, shown):
    assert calibrate(board=BOARD.replace(*change)) == (
        2, [f"beltscape: {NOT_SHOWN.format(board)}; {shown}: correct board.toml"],
    )  # fmt: skip


def test_chessboard_instead_of_the_described_charuco_board(calibrate, chessboard_capture):
    Path("chess").symlink_to(chessboard_capture.folder)
    assert calibrate(capture="chess") == (
        2,
        [
            "beltscape: chess: no image shows the board (ChArUco 8×6, DICT_4X4_50, square 40 mm); "
            "they show a chessboard of 8×5 inner corners: correct board.toml"
        ],
    )


@pytest.mark.thorough
def test_a_chessboard_of_another_grid(calibrate, chessboard_capture):
    Path("chess").symlink_to(chessboard_capture.folder)
    assert calibrate(capture="chess", board=CHESSBOARD.replace("[8, 5]", "[9, 6]")) == (
        2,
        [
            "beltscape: chess: no image shows the board (chessboard 9×6 inner corners, square 40 mm); "
            "they show a chessboard of 8×5 inner corners: correct board.toml"
        ],
    )


@pytest.mark.thorough
def test_charuco_board_instead_of_the_described_chessboard(calibrate, two_images):
    assert calibrate(board=CHESSBOARD) == (
        2,
        [
            "beltscape: capture: no image shows the board (chessboard 8×5 inner corners, square 40 mm); "
            "they show markers DICT_4X4_50 with ids up to 23 on a board of 8 columns: correct board.toml"
        ],
    )


@pytest.mark.parametrize(
    ("legacy", "inverted"), [("true", "false"), ("false", "true"), ("true", "true")], ids=str
)
def test_wrong_flags_of_the_board(calibrate, two_images, legacy, inverted):
    wrong = [key for key, value in (("legacy", legacy), ("inverted", inverted)) if value == "true"]
    fit = " and ".join(f"{key} = false (or no such key)" for key in wrong)
    assert calibrate(board=f"{BOARD}legacy = {legacy}\ninverted = {inverted}\n") == (
        2, [f"beltscape: {NOT_SHOWN.format('8×6, DICT_4X4_50')}; the markers fit {fit}: correct board.toml"],
    )  # fmt: skip


def test_images_without_any_board(calibrate, two_images):
    for path in Path("capture").glob("*/*.png"):
        write_image(path, np.full((400, 480), 90, np.uint8))
    assert calibrate() == (
        2,
        [
            f"beltscape: {NOT_SHOWN.format('8×6, DICT_4X4_50')}; "
            "they show neither ArUco markers nor a chessboard: look at exposure and focus"
        ],
    )


def test_too_few_views(calibrate):
    for path in Path("capture").glob("*/*.png"):
        if path.stem > "01":
            path.unlink()
    code, lines = calibrate()
    assert (code, lines) == (
        2,
        [
            "warning: camera cam0 sees the board in 2 of 2 images; at least 3 tilted views are needed; "
            "going on without cam0",
            "warning: camera cam1 sees the board in 2 of 2 images; at least 3 tilted views are needed; "
            "going on without cam1",
            "beltscape: no camera can be calibrated, a rig needs two; "
            "take at least 3 tilted views with each camera",
        ],
    )


LETTERS = str.maketrans("0123456789", "abcdefghij")
"""For names without a number, by which frames would be matched."""


def test_no_shared_view(calibrate):
    for path in sorted(Path("capture/cam1").iterdir()):
        path.rename(path.with_name(f"later_{path.stem.translate(LETTERS)}.png"))
    code, lines = calibrate()
    assert (code, lines[-1]) == (
        2,
        "beltscape: capture: no frame is of two cameras (cam0 has 00 … 04 (5); cam1 has later_aa … later_ae (5)); "
        "give the images of one instant the same name in every camera's folder",
    )


@pytest.mark.parametrize("out", ["occupied", "occupied/below", "occupied/below/it"])
def test_an_out_that_cannot_be_written(run, out):
    Path("occupied").write_text("a file")
    assert run("calibrate", "capture", "--board=board.toml", f"--out={out}") == (
        2,
        [
            f"beltscape: {out}: cannot be written (occupied is a file, not a folder); "
            "choose another output folder"
        ],
    )
    assert Path("occupied").read_text() == "a file"


def test_a_missing_or_broken_board_toml(calibrate):
    assert calibrate(board=BOARD.replace("marker_mm", "marker")) == (
        2, ["beltscape: board.toml: unknown key marker; did you mean marker_mm?"],
    )  # fmt: skip
    Path("board.toml").unlink()
    assert calibrate() == (2, ["beltscape: board.toml: no such file"])


def test_a_rig_of_another_format(run):
    Path("rig.json").write_text('{"cam0": {"T_cn_cnm1": []}}')
    assert run("check", "capture", "--rig=rig.json", "--board=board.toml") == (
        2,
        [
            "beltscape: rig.json: format is None, not 'beltscape-rig/1'; "
            "give a rig.json of beltscape calibrate"
        ],
    )


def test_a_rig_of_other_cameras(run, charuco_capture):
    write_rig(Path("rig.json"), charuco_capture.rig)
    rename_camera("cam0", "left")
    rename_camera("cam1", "right")
    code, lines = run("check", "capture", "--rig=rig.json", "--board=board.toml")
    assert (code, lines[-1]) == (
        2,
        "beltscape: capture: has the cameras left, right, the rig cam0, cam1, cam2; "
        "at least two of them must be the same",
    )


def test_a_rig_of_another_image_size(run, charuco_capture):
    write_rig(Path("rig.json"), charuco_capture.rig)
    for path in Path("capture/cam0").iterdir():
        write_image(path, charuco_capture.render("cam0", path.stem)[:-10])
    code, lines = run("check", "capture", "--rig=rig.json", "--board=board.toml")
    assert (code, lines[-1]) == (
        2,
        "beltscape: capture/cam0: images are 480×390 px, the rig's cam0 has 480×400: they are cropped, or of another "
        "camera; images of the whole sensor, or binned in both directions alike, fit the rig; for these, calibrate "
        "with images of the same region",
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["calibrat", "x"],
            "beltscape: no command 'calibrat'; did you mean calibrate?; see: beltscape --help",
        ),
        (
            ["calibrate", "capture"],
            "beltscape calibrate: the following arguments are required: --board, --out; "
            "see: beltscape calibrate --help",
        ),
        (
            ["check", "--rig=rig.json", "--board=board.toml"],
            "beltscape check: the following arguments are required: capture; see: beltscape check --help",
        ),
        (
            ["check", "capture", "--rig=r", "--board=b", "--colour"],
            "beltscape check: unrecognized arguments: --colour; see: beltscape check --help",
        ),
    ],
)
def test_a_wrong_command_line(run, words, message):
    assert run(*words) == (2, [message])
