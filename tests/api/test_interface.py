"""The Python interface on the shipped scenes: from files and images to quantities."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

import beltscape as bs
from beltscape.files.ply import read_cloud
from beltscape.measure.lumps.lumps import Lumps
from beltscape.measure.volume.volume import Volume
from tests.synthetic.demo import DEMO


def read_true_volume_mm3(start_mm: float, end_mm: float) -> float:
    """Return the true load between two places along the belt, to the nearest mm."""
    scene = json.loads((DEMO / "truth" / "volume.json").read_text())["scenes"]["belt_loaded"]
    first, last = (round(place - scene["first_y_mm"]) for place in (start_mm, end_mm))
    return float(np.sum(scene["area_mm2"][first:last]))


def test_depth_follows_the_images_and_nothing_is_printed(scenes, capsys):
    depth = scenes["belt_loaded"].depth
    assert depth.coverage > 0.85
    assert 560 < np.nanmin(depth.depth_mm) < np.nanmax(depth.depth_mm) < 760
    assert capsys.readouterr() == ("", "")


def test_plain_arrays_give_the_same_depth_as_a_frame_set(scenes, rig):
    scene = scenes["module"]
    matcher = bs.Reconstructor(rig, preset="fast", threads=1)
    depth = matcher(dict(scene.frame.images))
    np.testing.assert_array_equal(depth.depth_mm, scene.depth.depth_mm)
    assert matcher.warnings == ()


def test_a_moved_camera_is_in_the_warnings(scenes, rig):
    images = {
        name: cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        for name, image in scenes["module"].frame.images.items()
    }
    images["cam2"] = np.ascontiguousarray(images["cam2"][::-1, ::-1])
    matcher = bs.Reconstructor(bs.scale_rig(rig, 0.5), preset="fast", depth_range_mm=(600, 780))
    matcher(images)
    assert any("cam2" in line for line in matcher.warnings)


@pytest.fixture(scope="module")
def volume(scenes, belt, rig) -> Volume:
    return bs.measure_volume(scenes["belt_loaded"].depth, belt, rig, along_mm=(-200, 200))


@pytest.fixture(scope="module")
def lumps(scenes, belt, rig) -> Lumps:
    return bs.measure_lumps(scenes["belt_loaded"].depth, rig, belt=belt, oversize_mm=60)


def test_volume_of_the_load(volume):
    assert volume.volume_mm3 == pytest.approx(
        read_true_volume_mm3(-200, 200), rel=0.03
    )  # preset fast, 612 px
    assert volume.sigma_mm3 < 0.02 * volume.volume_mm3
    assert volume.height_map is volume.load
    assert abs(volume.along_mm[0] + 200) < 1e-9


def test_lumps_features_and_cloud(scenes, lumps, rig, tmp_path):
    loaded, module = scenes["belt_loaded"], scenes["module"]
    assert len(lumps.lumps) > 100
    assert lumps.oversize is not None
    features = bs.measure_features(
        module.depth, rig, DEMO / "module.toml", image=module.frame.images[rig.core]
    )
    errors = [abs(one.measured_mm - one.nominal_mm) for one in features.quantities]
    assert np.nanmedian(errors) < 0.5
    cloud = bs.point_cloud(loaded.depth, rig, loaded.frame.images[rig.core])
    bs.write_ply(cloud, tmp_path / "cloud.ply")
    assert len(read_cloud(tmp_path / "cloud.ply").points_mm) == loaded.depth.measured.sum()


def test_rig_and_belt_survive_their_files(belt, rig, tmp_path):
    bs.write_rig(rig, str(tmp_path / "rig.json"))
    bs.write_belt(belt, tmp_path / "belt.json")
    again = bs.read_belt(str(tmp_path / "belt.json"))
    np.testing.assert_array_equal(again.z_mm, belt.z_mm)
    assert again.camera is not None
    np.testing.assert_array_equal(
        bs.read_rig(tmp_path / "rig.json").core_camera.matrix, rig.core_camera.matrix
    )


def test_capture_without_a_rig(rig):
    frames = bs.read_capture(DEMO / "belt_loaded")
    assert [frame.frame for frame in frames] == ["000"]
    assert set(frames.cameras) == set(rig.cameras)


@pytest.mark.parametrize("name", ["rig", "belt", "depth", "volume", "lumps"])
def test_results_have_a_line_and_a_picture(name, scenes, belt, rig, volume, lumps):
    depth = scenes["belt_loaded"].depth
    result = {"rig": rig, "belt": belt, "depth": depth, "volume": volume, "lumps": lumps}[name]
    assert "\n" not in repr(result)
    assert repr(result).startswith(type(result).__name__ + "(")
    assert len(repr(result)) < 120
    assert result.plot().get_axes()
    html = result._repr_html_()
    assert "data:image/png;base64," in html
    assert len(html) < 3_000_000
