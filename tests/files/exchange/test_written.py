"""Exported rigs, read by the other programs' own readers or checked against their rules."""

from __future__ import annotations

import json
import re

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given

from beltscape.core.errors import BeltscapeError, InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.files.exchange import export_rig
from beltscape.files.exchange.kalibr import fit_without_k3
from tests.strategies import cameras as some_cameras
from tests.strategies import rigs
from tests.thorough import examples

TURN = Pose.of([0.3, -0.2, 0.1], [100.0, -20.0, 5.0])
FAR = Pose.of([0.0, 0.0, 0.5], [-250.0, 0.0, 0.0])
POINT_MM = np.array([40.0, -30.0, 900.0])


@pytest.fixture
def rig() -> Rig:
    """Three cameras, the core in the middle, one lens with k3."""
    lens = np.array([-0.1, 0.02, 1e-3, -2e-3, 0.0])
    cameras = {
        name: Camera(name, (640, 480), np.array([800.0, 801.5]), np.array([319.25, 241.0]), lens)
        for name in ("left", "mid", "right")
    }
    bent = np.array([-0.1, 0.02, 1e-3, -2e-3, 0.01])
    cameras["right"] = Camera("right", (800, 600), np.full(2, 900.0), np.array([400.0, 300.0]), bent)
    return Rig("mid", cameras, {"left": TURN, "mid": Pose.identity(), "right": FAR})


def written(tmp_path, rig: Rig, kind: str, name: str = "") -> tuple[str, list[str]]:
    reporter = Silent()
    export_rig(tmp_path / "out", rig, kind, reporter)
    return (tmp_path / "out" / name if name else tmp_path / "out").read_text(
        encoding="utf-8"
    ), reporter.warnings


@examples(15)
@given(rigs())
def test_opencv_reads_what_is_written_and_projects_the_same(tmp_path_factory, rig):
    path = tmp_path_factory.getbasetemp() / "opencv.yaml"
    export_rig(path, rig, "opencv", Silent())
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    assert storage.getNode("core").string() == rig.core
    listed = storage.getNode("cameras")
    assert listed.size() == len(rig.cameras)
    for i, (name, camera) in enumerate(rig.cameras.items()):
        node, pose = listed.at(i), rig.cam_from_core[name]
        assert node.getNode("name").string() == name
        assert (node.getNode("image_width").real(), node.getNode("image_height").real()) == camera.size_px
        np.testing.assert_array_equal(node.getNode("camera_matrix").mat(), camera.matrix)
        np.testing.assert_array_equal(node.getNode("distortion_coefficients").mat()[0], camera.distortion)
        np.testing.assert_array_equal(node.getNode("R").mat(), pose.rotation)
        np.testing.assert_array_equal(node.getNode("T").mat()[:, 0], pose.translation_mm)


def test_opencvs_projection_of_its_file_is_ours(tmp_path, rig):
    export_rig(tmp_path / "out.yaml", rig, "opencv", Silent())
    storage = cv2.FileStorage(str(tmp_path / "out.yaml"), cv2.FILE_STORAGE_READ)  # its nodes die with it
    listed = storage.getNode("cameras")
    for i, (name, camera) in enumerate(rig.cameras.items()):
        k, d, r, t = (
            listed.at(i).getNode(key).mat() for key in ("camera_matrix", "distortion_coefficients", "R", "T")
        )
        seen, _ = cv2.projectPoints(POINT_MM[None], cv2.Rodrigues(r)[0], t, k, d)
        expected = camera.project(rig.cam_from_core[name].apply(POINT_MM))
        np.testing.assert_allclose(seen.ravel(), expected, rtol=0, atol=1e-8)


def test_kalibrs_chain_starts_at_the_core_in_metres(tmp_path, rig):
    text, warnings = written(tmp_path, rig, "kalibr")
    chain = yaml.safe_load(text)
    assert list(chain) == ["cam0", "cam1", "cam2"]
    assert [chain[key]["rostopic"] for key in chain] == [f"/{n}/image_raw" for n in ("mid", "left", "right")]
    assert "T_cn_cnm1" not in chain["cam0"]
    assert chain["cam1"]["cam_overlaps"] == [0, 2]
    # point of the core in metres, through the chain, as Kalibr's docs have it
    left = np.array(chain["cam1"]["T_cn_cnm1"]) @ [*POINT_MM / 1000, 1]
    right = np.array(chain["cam2"]["T_cn_cnm1"]) @ left
    np.testing.assert_allclose(left[:3] * 1000, TURN.apply(POINT_MM), rtol=1e-12)
    np.testing.assert_allclose(right[:3] * 1000, FAR.apply(POINT_MM), rtol=1e-12)
    # the types ConfigReader.py insists on
    assert chain["cam0"]["resolution"] == [640, 480]
    assert all(
        isinstance(x, float) for key in ("intrinsics", "distortion_coeffs") for x in chain["cam2"][key]
    )
    assert chain["cam0"]["distortion_coeffs"] == [-0.1, 0.02, 1e-3, -2e-3]
    assert len(chain["cam2"]["distortion_coeffs"]) == 4
    (warning,) = warnings
    assert re.search(
        r"out: camera right: Kalibr's radtan has no k3 \(0\.01\); .* by \S+ px RMS, \S+ px at most$", warning
    )


@examples(20)
@given(some_cameras())
def test_the_lens_without_k3_is_the_nearest_and_its_figures_hold(camera):
    coefficients, rms_px, largest_px = fit_without_k3(camera)
    near, cut = (
        Camera("c", camera.size_px, camera.focal_px, camera.center_px, np.array([*four, 0.0]))
        for four in (coefficients, camera.distortion[:4])
    )
    w, h = camera.size_px
    pixels = np.stack(np.meshgrid(np.linspace(0, w - 1, 64), np.linspace(0, h - 1, 64)), axis=-1)
    ideal = camera.undistort(pixels)

    def off_px(other: Camera) -> np.ndarray:
        return np.linalg.norm((other.distort(ideal) - camera.distort(ideal)) * camera.focal_px, axis=-1)

    assert np.sqrt(np.nanmean(off_px(near) ** 2)) == pytest.approx(rms_px, rel=1e-6, abs=1e-9)
    assert np.nanmax(off_px(near)) == pytest.approx(largest_px, rel=1e-6, abs=1e-9)
    assert rms_px <= np.sqrt(np.nanmean(off_px(cut) ** 2)) + 1e-9


def test_colmaps_reference_stands_first_and_pixels_count_from_the_corner(tmp_path, rig):
    text, warnings = written(tmp_path, rig, "colmap")
    (only,) = json.loads(text)
    mid, left, right = only["cameras"]
    assert warnings == []
    assert (mid["image_prefix"], mid["ref_sensor"]) == ("mid/", True)
    assert "cam_from_rig_rotation" not in mid  # COLMAP refuses a reference with a pose
    assert left["camera_model_name"] == "OPENCV"
    assert left["camera_params"] == [800.0, 801.5, 319.75, 241.5, -0.1, 0.02, 1e-3, -2e-3]
    assert right["camera_model_name"] == "FULL_OPENCV"
    assert right["camera_params"][8:] == [0.01, 0, 0, 0]
    w, *v = left["cam_from_rig_rotation"]
    p = POINT_MM / 1000
    turned = p + 2 * np.cross(v, np.cross(v, p) + w * p)  # q p q*
    np.testing.assert_allclose(
        turned + left["cam_from_rig_translation"], TURN.apply(POINT_MM) / 1000, rtol=1e-12
    )


def test_ros_has_its_keys_and_tf_points_from_child_to_parent(tmp_path, rig):
    info = yaml.safe_load(written(tmp_path, rig, "ros", "left.yaml")[0])
    assert list(info) == [
        "image_width", "image_height", "camera_name", "camera_matrix", "distortion_model",
        "distortion_coefficients", "rectification_matrix", "projection_matrix",
    ]  # fmt: skip
    assert (info["camera_name"], info["distortion_model"]) == ("left", "plumb_bob")
    assert info["camera_matrix"] == {
        "rows": 3,
        "cols": 3,
        "data": [800.0, 0, 319.25, 0, 801.5, 241.0, 0, 0, 1],
    }
    assert info["distortion_coefficients"] == {"rows": 1, "cols": 5, "data": [-0.1, 0.02, 1e-3, -2e-3, 0.0]}
    assert info["projection_matrix"]["data"] == [800.0, 0, 319.25, 0, 0, 801.5, 241.0, 0, 0, 0, 1, 0]
    poses = yaml.safe_load((tmp_path / "out" / "extrinsics.yaml").read_text())
    left, right = poses["transforms"]
    assert (left["header"]["frame_id"], left["child_frame_id"]) == ("mid_optical_frame", "left_optical_frame")
    assert right["child_frame_id"] == "right_optical_frame"
    # the translation is where the child's origin lies in the parent
    np.testing.assert_allclose(
        [*left["transform"]["translation"].values()], TURN.center_mm / 1000, rtol=1e-12
    )
    x, y, z, w = (left["transform"]["rotation"][key] for key in "xyzw")
    p, v = TURN.apply(POINT_MM) / 1000, np.array([x, y, z])
    moved = p + 2 * np.cross(v, np.cross(v, p) + w * p) + [*left["transform"]["translation"].values()]
    np.testing.assert_allclose(moved, POINT_MM / 1000, rtol=1e-12)


def test_a_name_that_cannot_be_a_file_is_refused_before_anything_is_written(tmp_path):
    camera = Camera("a/b", (64, 48), np.full(2, 80.0), np.array([32.0, 24.0]), np.zeros(5))
    rig = Rig("a/b", {"a/b": camera}, {"a/b": Pose.identity()})
    with pytest.raises(InputError, match=r"camera name 'a/b' cannot name a file here; rename the camera"):
        export_rig(tmp_path / "out", rig, "ros", Silent())
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("kind", ["opencv", "kalibr", "colmap"])
def test_failed_write_leaves_nothing_behind(tmp_path, rig, kind):
    (tmp_path / "out").mkdir()
    with pytest.raises(BeltscapeError, match="out"):
        export_rig(tmp_path / "out", rig, kind, Silent())
    assert [p.name for p in tmp_path.rglob("*")] == ["out"]
