"""``beltscape calibrate intrinsics`` and its file as known intrinsics of a rig."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.detection.detector import PrintVariant
from beltscape.core.errors import CalibrationError, InputError
from beltscape.core.progress import Silent
from beltscape.files.images import write_image
from beltscape.files.intrinsics_json import read_intrinsics_file
from beltscape.files.rig_json import read_rig, write_rig
from beltscape.files.rig_limits import find_corner_radius_px
from beltscape.pipeline.calibrating import calibration, intrinsics
from beltscape.pipeline.calibrating.calibration import calibrate
from beltscape.pipeline.calibrating.intrinsics import read_known_intrinsics
from tests.synthetic.demo import parse_json
from tests.synthetic.lens_views import BROWN, place_everywhere, view_from
from tests.thorough import list_cases

BOARD = 'kind = "charuco"\nsquares = [8, 6]\nsquare_mm = 40\nmarker_mm = 29\ndictionary = "DICT_4X4_50"\n'


@pytest.fixture(scope="module")
def separate(tmp_path_factory, charuco_capture):
    """Views of the three cameras, none of them of one instant, and the intrinsics from them."""
    from beltscape.cli.main import main

    folder = tmp_path_factory.mktemp("separate")
    for k, name in enumerate(charuco_capture.rig.cameras):
        (folder / "views" / name).mkdir(parents=True)
        for source in sorted((charuco_capture.folder / name).iterdir()):
            shutil.copy(source, folder / "views" / name / f"{k}_{source.name}")
    (folder / "board.toml").write_text(BOARD)
    words = ["intrinsics", folder / "views", "--board", folder / "board.toml", "--out", folder / "out"]
    assert main(["calibrate", *map(str, words)]) == 0
    return folder


def test_intrinsics_of_separate_views_agree_with_the_truth_within_their_sigma(separate, charuco_capture):
    intrinsics = read_intrinsics_file(separate / "out" / "intrinsics.json")
    for name, true in charuco_capture.rig.cameras.items():
        found, sigma = intrinsics.cameras[name], np.sqrt(np.diag(intrinsics.covariances[name]))
        assert (np.abs(found.focal_px - true.focal_px) < 5 * sigma[:2]).all()
        assert (np.abs(found.center_px - true.center_px) < 5 * sigma[2:4]).all()
        assert (sigma[:4] < 3).all()
        assert intrinsics.quality[name]["held_out_rms_px"] < 0.1


def test_one_camera_may_be_a_folder_of_images(separate, run, tmp_path):
    words = separate / "views" / "cam1", "--board", separate / "board.toml", "--out", tmp_path, "--json"
    code, out, _ = run("calibrate", "intrinsics", *words)
    assert code == 0
    assert list(parse_json(out)["cameras"]) == ["cam1"]


def test_a_rational_lens_is_known_as_far_as_its_corners_reached(separate, run, tmp_path):
    words = separate / "views" / "cam1", "--board", separate / "board.toml", "--out", tmp_path
    assert run("calibrate", "intrinsics", *words, "--lens-model", "rational")[0] == 0
    camera = read_intrinsics_file(tmp_path / "intrinsics.json").cameras["cam1"]
    reach_px = camera.valid_radius_px
    assert reach_px is not None
    assert reach_px < find_corner_radius_px(camera)
    within, beyond = (camera.center_px + np.array([share * reach_px, 0.0]) for share in (0.99, 1.01))
    assert np.isfinite(camera.undistort(within)).all()
    assert np.isnan(camera.undistort(beyond)).all()


def test_a_capture_called_intrinsics_is_chosen_before_the_word(run, tmp_path, charuco_capture, monkeypatch):
    def stop(capture, *_args, **_options):
        raise CalibrationError(f"a capture: {capture}")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(calibration, "calibrate", stop)
    (tmp_path / "board.toml").write_text(BOARD)
    (tmp_path / "intrinsics").symlink_to(charuco_capture.folder)
    code, _, err = run("calibrate", "intrinsics", "--board", "board.toml", "--out", "rig")
    assert (code, err) == (2, ["beltscape: a capture: intrinsics"])


@pytest.mark.thorough
def test_a_capture_called_intrinsics_is_still_a_capture(
    separate, run, tmp_path, charuco_capture, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "intrinsics").symlink_to(charuco_capture.folder)
    code, out, _ = run(
        "calibrate", "intrinsics", "--board", separate / "board.toml", "--out", "rig", "--json"
    )
    assert code == 0
    assert len(read_rig(tmp_path / "rig" / "rig.json").cameras) == 3
    assert parse_json(out)["cameras"]["cam0"]["intrinsics"] == "estimated"


@pytest.fixture(scope="module")
def few(tmp_path_factory, charuco_capture):
    """Four joint frames, too few for good lenses."""
    folder = tmp_path_factory.mktemp("few")
    for name in charuco_capture.rig.cameras:
        (folder / name).mkdir()
        for source in sorted((charuco_capture.folder / name).iterdir())[:4]:
            shutil.copy(source, folder / name)
    return folder


@pytest.mark.parametrize("use", list_cases(["held", "prior"], ["prior"]))
def test_intrinsics_are_held_or_a_prior(separate, few, charuco_capture, use):
    board = charuco_capture.board
    path = separate / "out" / "intrinsics.json"
    known = read_known_intrinsics(path, board, Silent(), use=use)
    rig = calibrate(few, board, "cam0", Silent(), known=known).rig
    for name, true in charuco_capture.rig.cameras.items():
        prior = known.cameras[name]
        assert (rig.cameras[name].focal_px == prior.focal_px).all() == (use == "held")
        assert np.abs(rig.cameras[name].focal_px - true.focal_px).max() < 1.0


def test_intrinsics_are_estimated_from_a_folder_of_views(separate, charuco_capture):
    known = read_known_intrinsics(separate / "views", charuco_capture.board, Silent(), use="prior")
    found = read_intrinsics_file(separate / "out" / "intrinsics.json")
    for name, camera in known.cameras.items():
        np.testing.assert_allclose(camera.focal_px, found.cameras[name].focal_px, rtol=1e-9)
    assert list(known.cameras) == list(found.cameras)


@pytest.mark.thorough
def test_a_folder_of_views_serves_as_intrinsics(separate, few, run, tmp_path):
    words = "--board", separate / "board.toml", "--out", tmp_path / "rig", "--json"
    code, out, _ = run(
        "calibrate", few, "--intrinsics", separate / "views", "--intrinsics-as", "prior", *words
    )
    assert code == 0
    assert {camera["intrinsics"] for camera in parse_json(out)["cameras"].values()} == {"prior"}


def test_intrinsics_without_covariance_are_no_prior(tmp_path, charuco_capture):
    write_rig(tmp_path / "rig.json", charuco_capture.rig)
    with pytest.raises(
        InputError, match="holds no covariance of the intrinsics of cam0, cam1, cam2, which a prior"
    ):
        read_known_intrinsics(tmp_path / "rig.json", charuco_capture.board, Silent(), use="prior")


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"covariance": [[1.0]]}, "cameras.cam0.covariance must be 9×9 numbers, symmetric"),
        ({"covariance": (-np.eye(9)).tolist()}, "cameras.cam0.covariance is no covariance"),
        ({"focal_px": [0, 1]}, "cameras.cam0.focal_px = [0, 1]: must be positive"),
        ({"distortion": [1]}, "cameras.cam0.distortion has 1 numbers"),
    ],
)
def test_an_invalid_file_is_refused_naming_the_key(separate, tmp_path, change, line):
    document = json.loads((separate / "out" / "intrinsics.json").read_text())
    document["cameras"]["cam0"].update(change)
    path = tmp_path / "intrinsics.json"
    path.write_text(json.dumps(document))
    with pytest.raises(InputError) as error:
        read_intrinsics_file(path)
    assert line in str(error.value)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["views", "capture"], "give one capture folder, or the word intrinsics and a folder of board views"),
        (["intrinsics", "views", "--core", "a"], "--core has no meaning for single cameras"),
        (["views", "--intrinsics-as", "prior"], "give the intrinsics, with --intrinsics PATH"),
    ],
)
def test_options_without_effect_are_refused(run, tmp_path, words, line):
    code, _, err = run("calibrate", *words, "--board", "board.toml", "--out", tmp_path / "out")
    assert code == 2
    assert line in err[-1]
    assert not (tmp_path / "out").exists()


def test_a_bent_board_is_measured_or_said_to_be_indistinguishable(tmp_path, monkeypatch, run):
    """On exact corners of a board that is bent by 0.2 mm: 12 views state its shape, 6 that they cannot."""
    seen = view_from(BROWN, place_everywhere, 1, bend_mm=0.2, count=12)
    few = BoardDetections(seen.sizes_px, {"c": dict(list(seen.views["c"].items())[:6])}, {"c": 6})
    (tmp_path / "board.toml").write_text('kind = "chessboard"\ncorners = [14, 9]\nsquare_mm = 30\n')
    write_image(tmp_path / "c" / "00.png", np.zeros((2, 2), np.uint8))
    for detections, words in (
        (seen, "the board deviates from its drawing by 0."),
        (few, "with fewer than 8 views"),
    ):
        monkeypatch.setattr(
            intrinsics, "detect_board", lambda *_args, found=detections: (found, PrintVariant())
        )
        options = "--board", tmp_path / "board.toml", "--out", tmp_path / "out", "--json"
        code, out, _ = run("calibrate", "intrinsics", tmp_path / "c", *options)
        assert code == 0
        document = parse_json(out)
        assert any(words in note for note in document["notes"])
        quality = document["cameras"]["c"]["quality"]
        assert (quality["board_off_drawing_rms_mm"][2] > 0.1) == (detections is seen)
        if detections is seen:
            assert quality["rms_px"] < quality["held_out_rms_px"] < 0.1
            assert quality["sigma"]["fx"] == pytest.approx(
                np.sqrt(document["cameras"]["c"]["covariance"][0][0])
            )
