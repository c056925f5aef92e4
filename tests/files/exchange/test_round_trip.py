"""Export and import of rigs: what a format carries survives to the last digits."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from hypothesis import given

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.files.exchange import FORMATS, detect_format, export_rig, import_rig, read_intrinsics
from beltscape.files.rig_json import read_rig, write_rig
from tests.strategies import rigs
from tests.thorough import examples

NAMES = ["Förderband links", "cam-1", "0815", "yes"]
"""Names that YAML, COLMAP prefixes and ROS topics could stumble over."""


def fit_without_k3(rig: Rig) -> Rig:
    cameras = {
        name: Camera(name, c.size_px, c.focal_px, c.center_px, c.distortion * [1, 1, 1, 1, 0])
        for name, c in rig.cameras.items()
    }
    return Rig(rig.core, cameras, rig.cam_from_core)


def assert_same(back: Rig, rig: Rig) -> None:
    assert (back.core, set(back.cameras)) == (rig.core, set(rig.cameras))
    reach_mm = max(float(np.linalg.norm(p.translation_mm)) for p in rig.cam_from_core.values())
    for name, camera in rig.cameras.items():
        read, pose, placed = back.cameras[name], rig.cam_from_core[name], back.cam_from_core[name]
        assert (read.name, read.size_px) == (name, camera.size_px)
        for key in ("focal_px", "center_px", "distortion"):
            np.testing.assert_allclose(getattr(read, key), getattr(camera, key), rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(placed.rotation, pose.rotation, rtol=0, atol=1e-9)
        np.testing.assert_allclose(placed.translation_mm, pose.translation_mm, rtol=0, atol=1e-9 * reach_mm)


def there_and_back(folder, rig: Rig, kind: str) -> tuple[Rig, list[str]]:
    path = folder / f"{kind}.{'json' if kind == 'colmap' else 'yaml'}"
    shutil.rmtree(path, ignore_errors=True)
    reporter = Silent()
    files = export_rig(path, rig, kind, reporter)
    assert all(file.is_file() for file in files)
    assert not list(path.parent.glob(f".{path.stem}*.part*"))
    assert detect_format(path) == kind
    back, found = import_rig(path, reporter)
    assert found == kind
    return back, reporter.warnings


@pytest.mark.parametrize("kind", ["opencv", "colmap", "ros"])
@examples(25)
@given(rig=rigs())
def test_content_of_a_format_reads_back_unchanged(tmp_path_factory, kind, rig):
    back, warnings = there_and_back(tmp_path_factory.getbasetemp(), rig, kind)
    assert warnings == []
    assert_same(back, rig)


@examples(25)
@given(rig=rigs())
def test_kalibr_carries_all_but_k3(tmp_path_factory, rig):
    rig = fit_without_k3(rig)
    back, warnings = there_and_back(tmp_path_factory.getbasetemp(), rig, "kalibr")
    assert warnings == []
    assert_same(back, rig)


@pytest.mark.parametrize("kind", FORMATS)
def test_names_and_a_core_that_is_not_the_first_survive(tmp_path, kind):
    cameras = {
        name: Camera(name, (640, 480), np.array([800.0, 801 + i]), np.array([320.0, 240.0]), np.zeros(5))
        for i, name in enumerate(NAMES)
    }
    poses = {name: Pose.of([0.1 * i, 0.2, -0.3], [10.0 * i, 5.0, -3.0]) for i, name in enumerate(NAMES)}
    rig = Rig(NAMES[2], cameras, {**poses, NAMES[2]: Pose.identity()})
    assert_same(there_and_back(tmp_path, rig, kind)[0], rig)


@pytest.mark.parametrize("kind", FORMATS)
def test_the_core_can_be_chosen_at_import(tmp_path, kind):
    placed = Pose.of([0.0, 0.1, 0.0], [-100.0, 0.0, 2.0])
    cameras = {
        name: Camera(name, (64, 48), np.full(2, 80.0), np.array([32.0, 24.0]), np.zeros(5)) for name in "ab"
    }
    export_rig(tmp_path / "out.json", Rig("a", cameras, {"a": Pose.identity(), "b": placed}), kind, Silent())
    back, _ = import_rig(tmp_path / "out.json", Silent(), kind=kind, core="b")
    assert back.core == "b"
    np.testing.assert_array_equal(back.cam_from_core["b"].translation_mm, np.zeros(3))
    np.testing.assert_allclose(back.cam_from_core["a"].translation_mm, placed.inverse().translation_mm)
    write_rig(tmp_path / "rig.json", back)
    assert_same(read_rig(tmp_path / "rig.json"), back)


@given(rig=rigs(minimum=1, maximum=2))
@examples(10)
def test_intrinsics_come_from_every_format_and_from_rig_json(tmp_path_factory, rig):
    folder = tmp_path_factory.mktemp("intrinsics")
    rig = fit_without_k3(rig)
    write_rig(folder / "rig.json", rig)
    export_rig(folder / "ros", rig, "ros", Silent())
    (folder / "ros" / "extrinsics.yaml").unlink()
    for kind in ("opencv", "kalibr", "colmap"):
        export_rig(folder / f"{kind}.json", rig, kind, Silent())
        if kind != "colmap":
            (folder / f"{kind}.json").rename(folder / f"{kind}.yaml")
    for source in ("rig.json", "ros", "opencv.yaml", "kalibr.yaml", "colmap.json"):
        found = read_intrinsics(folder / source)
        assert set(found) == set(rig.cameras)
        for name, camera in rig.cameras.items():
            np.testing.assert_allclose(found[name].matrix, camera.matrix, rtol=1e-12)
            np.testing.assert_allclose(found[name].distortion, camera.distortion, rtol=1e-12)
