"""Files of the truth in both layouts: depth, regions and occluded pixels; refused files."""

from __future__ import annotations

import json

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.evaluate.truth import read_truth
from beltscape.files.json_text import write_json
from beltscape.files.rig_json import write_rig

SIZE = (40, 30)
WORLD_UP = Pose(np.diag([1.0, -1, -1]), np.array([0.0, 0.0, 700.0]))


def rig() -> Rig:
    cameras = {
        name: Camera(name, SIZE, np.full(2, 40.0), np.array([19.5, 14.5]), np.zeros(5))
        for name in ("cam0", "cam1")
    }
    return Rig("cam0", cameras, {"cam0": Pose.identity(), "cam1": Pose.of([0, 0, 0], [-200, 0, 0])})


def arrays() -> tuple[np.ndarray, np.ndarray]:
    depth, label = np.full(SIZE[::-1], 700.0, np.float32), np.ones(SIZE[::-1], np.uint8)
    label[10:20, 10:20], depth[10:20, 10:20] = 2, 640.0
    depth[:, 0], label[:, 0] = np.nan, 0
    return depth, label


@pytest.fixture
def ours(tmp_path):
    depth, label = arrays()
    views = np.where(np.arange(40) < 5, 0, 1) * np.ones((30, 1))
    write_rig(tmp_path / "rig.json", rig())
    pose = {"rotation": WORLD_UP.rotation, "translation_mm": WORLD_UP.translation_mm}
    write_json(tmp_path / "station.json", {"core_from_world": pose})
    np.savez(tmp_path / "belt_loaded_depth.npz", depth_mm=depth, label=label, views=views.astype(np.uint8))
    return tmp_path


def test_our_own_layout(ours):
    truth = read_truth(ours).for_frame("anything")
    depth, label = arrays()
    np.testing.assert_array_equal(truth.depth_mm, depth)
    np.testing.assert_array_equal(truth.label, label)
    np.testing.assert_array_equal(truth.occluded.sum(axis=0), [0, 30, 30, 30, 30] + [0] * 35)


def test_regions_end_along_the_belt(ours):
    truth = read_truth(ours / "belt_loaded_depth.npz").truths[0]
    regions = truth.region_masks(150.0)
    assert set(regions) == {"belt", "material", "all"}
    np.testing.assert_array_equal(regions["all"], regions["belt"] | regions["material"])
    rows = np.flatnonzero(regions["belt"].any(axis=1))
    # (row − 14.5) / 40 · 700 mm
    assert rows.min() == 6
    assert rows.max() == 23


def test_the_layout_by_camera(tmp_path, ours):
    by_camera = tmp_path / "other"
    by_camera.mkdir()
    depth, label = arrays()
    cameras = {
        name: {
            "K": camera.matrix.tolist(), "dist": [0] * 5, "R": (pose @ WORLD_UP).rotation.tolist(),
            "t": (pose @ WORLD_UP).translation_mm.tolist(), "R_rel": pose.rotation.tolist(),
            "t_rel": pose.translation_mm.tolist(),
        }
        for (name, camera), pose in zip(rig().cameras.items(), rig().cam_from_core.values(), strict=True)
    }  # fmt: skip
    (by_camera / "rig.json").write_text(json.dumps({"image_size": SIZE, "cameras": cameras}))
    np.savez(by_camera / "belt_loaded_depth_cam0.npz", z_pinhole=depth, label_pinhole=label)
    truth, same = read_truth(by_camera, "belt_loaded").truths[0], read_truth(ours).truths[0]
    np.testing.assert_array_equal(truth.depth_mm, same.depth_mm)
    assert truth.core_from_world is not None
    np.testing.assert_allclose(truth.core_from_world.translation_mm, WORLD_UP.translation_mm)
    # cast from the found depth: what the auxiliary has left of its image, and behind the box
    assert truth.occluded.any()
    assert not truth.occluded[:, 30:].any()


def test_a_truth_for_each_frame(ours):
    depth, label = arrays()
    np.savez(
        ours / "belt_moving_depth.npz", depth_mm=np.stack([depth, depth + 5]), label=np.stack([label] * 2)
    )
    truth = read_truth(ours, "belt_moving")
    assert len(truth.truths) == 2
    assert np.nanmax(truth.for_frame("001").depth_mm) == 705
    with pytest.raises(InputError, match="no truth of frame 002"):
        truth.for_frame("002")
    with pytest.raises(InputError, match="2 scenes in it"):
        read_truth(ours)


def test_on_its_own_grid_it_is_itself(ours):
    truth = read_truth(ours).truths[0]
    again = truth.resample_to(truth.rig)
    np.testing.assert_allclose(again.depth_mm, truth.depth_mm, rtol=1e-12)
    np.testing.assert_array_equal(again.label, truth.label)
    np.testing.assert_array_equal(again.occluded, truth.occluded)


def test_what_is_missing_is_named(tmp_path, ours):
    with pytest.raises(InputError, match="no such truth"):
        read_truth(tmp_path / "nowhere")
    np.savez(ours / "other_depth.npz", a=np.zeros(3))
    with pytest.raises(InputError, match="no depth_mm and label"):
        read_truth(ours, "other")
    np.savez(ours / "small_depth.npz", depth_mm=np.zeros((3, 4)), label=np.zeros((3, 4)))
    with pytest.raises(InputError, match="4×3 px"):
        read_truth(ours, "small")
    whole = (ours / "small_depth.npz").read_bytes()
    for content in (b"no npz", b"", whole[: len(whole) // 2]):
        (ours / "broken_depth.npz").write_bytes(content)
        with pytest.raises(InputError, match="not a truth's npz"):
            read_truth(ours, "broken")
