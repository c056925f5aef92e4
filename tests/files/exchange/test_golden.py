"""Rig files as other programs write them, made by hand after those programs' documentation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.core.progress import Silent
from beltscape.files.exchange import detect_format, import_rig, read_intrinsics
from tests.files.exchange.documented_files import COLMAP, KALIBR, OLD_OPENCV, OPENCV, ROS_LEFT, TF


@pytest.fixture
def put(tmp_path):
    """A function that writes a text below the test's folder and answers its path."""

    def put(name: str, text: str) -> Path:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
        return tmp_path / name

    return put


def test_opencvs_calibration_sample(put):
    path = put("left.yml", OPENCV)
    assert detect_format(path) == "opencv"
    rig, _ = import_rig(path, Silent())
    camera = rig.cameras["left"]
    assert (rig.core, camera.size_px) == ("left", (640, 480))
    np.testing.assert_array_equal(camera.focal_px, [535.91573396163199] * 2)
    np.testing.assert_array_equal(camera.center_px, [342.28315473308373, 235.57082909788173])
    np.testing.assert_array_equal(
        camera.distortion,
        [
            -0.26637260909660682,
            -0.038588898922304653,
            0.0017831947042852964,
            -2.8122100441115472e-04,
            0.23839153080878486,
        ],
    )


def test_a_folder_of_opencvs_files_gives_intrinsics_by_file_name(put):
    put("calib/left.yml", OPENCV)
    folder = put("calib/right.yaml", OLD_OPENCV).parent
    found = read_intrinsics(folder, Silent())
    assert list(found) == ["left", "right"]
    np.testing.assert_array_equal(found["right"].distortion, [-0.41, 0.52, 0, 1e-3, 0])
    with pytest.raises(InputError, match="has no pose of left, right; add its transform, or use the"):
        import_rig(folder, Silent())


def test_kalibrs_wiki_example(put):
    path, reporter = put("camchain.yaml", KALIBR), Silent()
    rig, kind = import_rig(path, reporter)
    assert (kind, rig.core, list(rig.cameras)) == ("kalibr", "cam0", ["cam0", "cam1", "cam2"])
    np.testing.assert_array_equal(rig.cameras["cam0"].center_px, [362.68, 246.049])
    np.testing.assert_array_equal(rig.cameras["cam1"].distortion, [-0.3, 0.1, 1e-3, 0, 0])
    np.testing.assert_array_equal(rig.cameras["cam2"].distortion, np.zeros(5))
    # cam1 = T_c1_c0 cam0, cam2 = T_c2_c1 cam1, by hand in mm
    point = np.array([10.0, 20.0, 30.0])
    np.testing.assert_allclose(rig.cam_from_core["cam1"].apply(point), [-100, -10, 23], atol=1e-12)
    np.testing.assert_allclose(rig.cam_from_core["cam2"].apply(point), [-100, -10, 123], atol=1e-12)
    assert reporter.warnings == []


def test_kalibrs_rounded_rotation_is_corrected_with_a_warning(put):
    path, reporter = (
        put("camchain.yaml", KALIBR.replace("[1.0, 0.0, 0.0, -0.11]", "[0.9999, 0.0, 0.0, -0.11]")),
        Silent(),
    )
    rig, _ = import_rig(path, reporter)
    np.testing.assert_allclose(
        rig.cam_from_core["cam1"].rotation @ rig.cam_from_core["cam1"].rotation.T, np.eye(3), atol=1e-15
    )
    assert reporter.warnings == [
        f"{path}: cam1.T_cn_cnm1 is rounded: it is off a rotation by 0.0001; the nearest one is taken"
    ]


def test_colmaps_documented_example(put):
    rig, kind = import_rig(put("rig_config.json", COLMAP), Silent())
    assert (kind, rig.core, list(rig.cameras)) == ("colmap", "camera1", ["camera1", "camera2"])
    np.testing.assert_array_equal(rig.cameras["camera1"].focal_px, [1000, 1000])
    np.testing.assert_array_equal(rig.cameras["camera1"].center_px, [319.5, 239.5])
    np.testing.assert_array_equal(rig.cameras["camera1"].distortion, [-0.05, 0, 0, 0, 0])
    np.testing.assert_array_equal(rig.cameras["camera2"].distortion, [-0.1, 0.02, 1e-3, 2e-3, 0.01])
    # a quarter turn about y: z goes to x, x to -z
    moved = rig.cam_from_core["camera2"].apply(np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(moved, [253, 2, -1], atol=1e-12)


def test_ros_camera_info_and_a_tree_of_transforms(put):
    put("ros/left.yaml", ROS_LEFT)
    put("ros/right.yaml", ROS_LEFT.replace("narrow_stereo/left", "right"))
    folder = put("ros/extrinsics.yaml", TF).parent
    rig, kind = import_rig(folder, Silent())
    assert (kind, rig.core) == ("ros", "narrow_stereo/left")
    camera = rig.cameras["right"]
    np.testing.assert_array_equal(camera.focal_px, [430.1, 430.5])  # not the rectified projection
    np.testing.assert_array_equal(camera.distortion, [-0.3375, 0.1115, -0.001, -5.3e-05, 0])
    # right stands 100 mm along left's x and is turned by +90° about z: its x is left's y
    seen = rig.cam_from_core["right"].apply(np.array([100.0, 7.0, 0.0]))
    np.testing.assert_allclose(seen, [7, 0, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("name", "text", "old", "new", "line"),
    [
        ("a.yml", OPENCV, "fisheye_model: 0", "fisheye_model: 1", r"5 coefficients: a fisheye has k1, k2, k3, k4"),
        ("a.yml", OPENCV, "image_width: 640", "image_width: 64.5", r"width and height = \[64\.5, 480\]: must be"),
        ("a.yml", OPENCV, "cols: 1\n", "cols: 2\n", r"distortion_coefficients has 5 numbers, not 5×2"),
        ("a.yml", OPENCV, "[ 5.359", "[ -5.359", r"focal length = \[-535\.9.*\]: must be positive"),
        ("a.yml", OPENCV, "data: [ -2.6", "data: [ x-2.6", r"coefficients\.data = .*must be a list of finite"),
        ("a.yml", OPENCV, "---", "--- [", r"not YAML \(line \d+, column \d+: "),
        ("a.yml", OLD_OPENCV, "650., 0.", "650., 3.", r"camera_matrix = .*: must be \[\[fx, 0, cx\]"),
        ("c.yaml", KALIBR, "distortion_model: none", "distortion_model: fov",
         r"cam2\.distortion_model = 'fov' is not known, only radtan, equidistant, none; calibrate with pin"),
        ("c.yaml", KALIBR, "camera_model: pinhole", "camera_model: omni", r"model = 'omni' is not known, only p"),
        ("c.yaml", KALIBR, "[0.0, 1.0, 0.0, 0.003]", "[0.0, 2.0, 0.0, 0.003]", r"cam1\.T_cn_cnm1 is not a rotation"),
        ("c.yaml", KALIBR, "  intrinsics: [458, ", "  intrinsics: [", r"cam1\.intrinsics = .*: must be 4 finite"),
        ("c.yaml", KALIBR, "  resolution: [752, 480]\n", "", r"cam0\.resolution is missing"),
        ("c.yaml", KALIBR, "cam1:\n  T_cn_cnm1:", "cam1:\n  T_old:", r"has no pose of cam1, cam2"),
        ("r.json", COLMAP, "SIMPLE_RADIAL", "THIN_PRISM_FISHEYE",
         r"camera1\.camera_model_name = 'THIN_PRISM_FISHEYE' is not known, only SIMPLE_PINHOLE, .*; let COLMAP use"),
        ("r.json", COLMAP, "0.01, 0, 0, 0]", "0.01, 0.3, 0]", r"camera2\.camera_params = .*must be 12 finite"),
        ("r.json", COLMAP, '"ref_sensor": true', '"ref_sensor": false', r"0 cameras have ref_sensor true"),
        ("r.json", COLMAP, '"width": 640, ', "", r'camera1: COLMAP keeps image sizes in its database; add "width"'),
        ("r.json", COLMAP, "0.7071067811865475, ", "0.9, ", r"must be a unit quaternion, its length is 1\.145"),
        ("r.json", COLMAP, "]\n  }\n]", "]\n  }, {\"cameras\": []}\n]", r"holds 2 rigs; keep the one to be read"),
        ("l.yaml", ROS_LEFT, "plumb_bob", "equidistant", r"5 coefficients: a fisheye has k1, k2, k3, k4"),
        ("l.yaml", ROS_LEFT, "plumb_bob", "thin_prism",
         r"l\.yaml\.distortion_model = 'thin_prism' is not known, only plumb_bob, rat"),
        ("l.yaml", "a: 1\n", "", "", r"is none of opencv, .*, vic3d, .*, caliscope; give a calibration"),
    ],
)  # fmt: skip
def test_invalid_file_is_refused_with_file_value_and_fix(put, name, text, old, new, line):
    assert old in text
    path = put(name, text.replace(old, new, 1))
    with pytest.raises(InputError, match=line) as caught:
        import_rig(path, Silent())
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_missing_file_is_refused_by_name(put, tmp_path):
    with pytest.raises(InputError, match=r"gone\.yaml: no such file"):
        import_rig(tmp_path / "gone.yaml", Silent())
    with pytest.raises(InputError, match=r"holds no \.yaml file; give a folder"):
        import_rig(put("empty/note.txt", "").parent, Silent())
    with pytest.raises(InputError, match=r"no camera 'cam9'; choose the core among cam0, cam1, cam2"):
        import_rig(put("c.yaml", KALIBR), Silent(), core="cam9")
    with pytest.raises(
        InputError, match=r"format 'matlab' is not known; there are opencv, kalibr, colmap, ros, vic3d"
    ):
        import_rig(tmp_path / "c.yaml", Silent(), kind="matlab")
    with pytest.raises(InputError, match=r"has no cam0; give a camchain\.yaml"):
        import_rig(put("a.yml", OPENCV), Silent(), kind="kalibr")


def test_a_forest_of_transforms_is_refused(put):
    put("ros/left.yaml", ROS_LEFT)
    put("ros/right.yaml", ROS_LEFT.replace("narrow_stereo/left", "right"))
    folder = put("ros/extrinsics.yaml", TF.replace("frame_id: base_link", "frame_id: right")).parent
    with pytest.raises(InputError, match=r"extrinsics\.yaml must be one tree of frames; its roots are none"):
        import_rig(folder, Silent())
