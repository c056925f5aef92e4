"""Rigs as other programs write them: OpenCV's stereo sample, MC-Calib, caliscope."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose, rotation_from_vector
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.files.exchange import detect_format, import_rig, read_intrinsics


def make_camera(name: str, model: str = "brown") -> Camera:
    lens = [-0.1, 0.02, 1e-3, -5e-4, 0.003] if model == "brown" else [0.02, -0.01, 0.004, -0.001]
    return Camera(
        name, (1280, 720), np.array([905.0, 907.0]), np.array([640.5, 358.0]), np.array(lens), model
    )


def make_rig(*names: str, model: str = "brown") -> Rig:
    poses = {
        name: Pose(
            rotation_from_vector(np.array([0.02 * k, -0.1 * k, 0.01 * k])),
            np.array([-120.0 * k, 3.0, 8.0 * k]),
        )
        for k, name in enumerate(names)
    }
    poses[names[0]] = Pose.identity()
    return Rig(names[0], {name: make_camera(name, model) for name in names}, poses)


def matrix(values: np.ndarray) -> dict:
    values = np.atleast_2d(values)
    return {"rows": values.shape[0], "cols": values.shape[1], "dt": "d", "data": values.ravel().tolist()}


def assert_same(rig: Rig, expected: Rig) -> None:
    assert list(rig.cameras) == list(expected.cameras)
    for name, camera in expected.cameras.items():
        assert rig.cameras[name].model == camera.model
        assert rig.cameras[name].size_px == camera.size_px
        np.testing.assert_allclose(rig.cameras[name].matrix, camera.matrix)
        np.testing.assert_allclose(rig.cameras[name].distortion, camera.distortion)
        np.testing.assert_allclose(
            rig.cam_from_core[name].rotation, expected.cam_from_core[name].rotation, atol=1e-12
        )
        np.testing.assert_allclose(
            rig.cam_from_core[name].translation_mm, expected.cam_from_core[name].translation_mm, atol=1e-9
        )


def write_stereo(folder: Path, rig: Rig, **more: object) -> Path:
    """Write the two files of OpenCV's sample, T in cm."""
    first, second = rig.cameras.values()
    folder.mkdir()
    lenses = {"M1": first.matrix, "D1": first.distortion, "M2": second.matrix, "D2": second.distortion}
    (folder / "intrinsics.yml").write_text(
        "%YAML:1.0\n---\n" + json.dumps({key: matrix(value) for key, value in lenses.items()})
    )
    pose = rig.cam_from_core["cam2"]
    parts = {"R": pose.rotation, "T": pose.translation_mm[:, None] / 10, "R1": np.eye(3), "P1": np.eye(3, 4)}
    (folder / "extrinsics.yml").write_text(
        "%YAML:1.0\n---\n" + json.dumps({**{key: matrix(value) for key, value in parts.items()}, **more})
    )
    return folder


def test_opencv_stereo(tmp_path):
    rig = make_rig("cam1", "cam2")
    folder = write_stereo(tmp_path / "stereo", rig, units="cm", image_width=1280, image_height=720)
    assert detect_format(folder) == "opencv-stereo"
    assert_same(import_rig(folder, Silent())[0], rig)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (
            {"image_width": 1280, "image_height": 720},
            "units = None: the unit of its translations is not known",
        ),
        ({"units": "inch", "image_width": 1280, "image_height": 720}, "units = 'inch'"),
        ({"units": "mm"}, "image_width is missing"),
    ],
)
def test_opencv_stereo_lacks_something(more, says, tmp_path):
    folder = write_stereo(tmp_path / "stereo", make_rig("cam1", "cam2"), **more)
    with pytest.raises(InputError, match=says):
        import_rig(folder, Silent())


@pytest.mark.parametrize("model", ["brown", "fisheye"])
def test_mc_calib(model, tmp_path):
    rig = make_rig("camera_0", "camera_1", "camera_2", model=model)
    document: dict = {"nb_camera": 3, "units": "m"}
    for name, camera in rig.cameras.items():
        pose = rig.cam_from_core[name].inverse()
        placed = np.eye(4)
        placed[:3, :3], placed[:3, 3] = pose.rotation, pose.translation_mm / 1000
        document[name] = {
            "camera_matrix": matrix(camera.matrix),
            "distortion_vector": matrix(camera.distortion),
            "distortion_type": int(model == "fisheye"),
            "img_width": 1280,
            "img_height": 720,
            "camera_pose_matrix": matrix(placed),
        }
    path = tmp_path / "calibrated_cameras_data.yml"
    path.write_text("%YAML:1.0\n---\n" + json.dumps(document))
    assert detect_format(path) == "mc-calib"
    assert_same(import_rig(path, Silent())[0], rig)


def test_caliscope(tmp_path):
    rig = make_rig("cam_0", "cam_1")
    world = Pose(rotation_from_vector(np.array([0.3, 2.0, -0.4])), np.array([100.0, 50.0, 900.0]))
    lines = []
    for key, (name, camera) in enumerate(rig.cameras.items()):
        pose = rig.cam_from_core[name] @ world
        rotation = pose.rotation.tolist() if key == 0 else pose.rotation_vector.tolist()
        lines += [
            f"[cameras.{key}]",
            "ignore = false",
            f"size = {list(camera.size_px)}",
            f"matrix = {camera.matrix.tolist()}",
            f"distortions = {camera.distortion.tolist()}",
            f"rotation = {rotation}",
            f"translation = {(pose.translation_mm / 1000).tolist()}",
        ]
    path = tmp_path / "camera_array.toml"
    path.write_text(
        "\n".join([*lines, "[cameras.2]", "ignore = true", "matrix = []", "distortions = []"]) + "\n"
    )
    assert detect_format(path) == "caliscope"
    assert_same(import_rig(path, Silent())[0], rig)
    assert list(read_intrinsics(path)) == ["cam_0", "cam_1"]


def test_a_recorded_camera_array_of_caliscope(real_data):
    rig, kind = import_rig(real_data("caliscope_4cam") / "reference_camera_array.toml", Silent())
    assert kind == "caliscope"
    assert len(rig.cameras) == 4
    # four webcams around a desk look at one place about 0.7 m away
    centers = np.array([pose.center_mm for pose in rig.cam_from_core.values()])
    assert 100 < np.linalg.norm(centers - centers[0], axis=1).max() < 2000
    axes = np.array([pose.rotation[2] for pose in rig.cam_from_core.values()])
    near = np.linalg.lstsq(
        np.concatenate([np.eye(3) - np.outer(a, a) for a in axes]),
        np.concatenate([(np.eye(3) - np.outer(a, a)) @ c for a, c in zip(axes, centers, strict=True)]),
        rcond=None,
    )[0]
    depths = [float(axis @ (near - center)) for axis, center in zip(axes, centers, strict=True)]
    assert min(depths) > 200, "the axes meet in front of every camera"


def test_json_is_still_json(tmp_path):
    path = tmp_path / "x.json"
    path.write_text(json.dumps({"nothing": 1}))
    with pytest.raises(InputError, match="is none of"):
        detect_format(path)
