"""The true heights of another renderer's moving belt, from depth maps of its frames, on a level load."""

import importlib
import json

import numpy as np
import pytest

from beltscape.core.geometry.pose import Pose

_HEIGHT_MM, _PLACES_MM = 50.0, {"003": 600.0, "004": 2000.0}
_DISTORTION = (-0.12, 0.05, 0.001, -0.002, 0.0)


@pytest.fixture
def rendered(tmp_path):
    """Truth of two frames over a load of even height between two walls, through a distorted and tilted core."""
    core_from_world = Pose.of([[1, 0, 0], [0, -0.9998, 0.02], [0, -0.02, -0.9998]], [5.0, -8.0, 740.0])
    matrix = [[1200.0, 0, 611.5], [0, 1200.0, 511.5], [0, 0, 1]]
    core = {"K": matrix, "dist": _DISTORTION, "R_rel": np.eye(3).tolist(), "t_rel": [0, 0, 0]}
    core |= {"R": core_from_world.rotation.tolist(), "t": core_from_world.translation_mm.tolist()}
    truth = tmp_path / "truth"
    truth.mkdir()
    documents = {
        "rig": {"image_size": [1224, 1024], "cameras": {"cam0": core}},
        "belt": {"cross_section": [[-380, 100], [-150, 0], [150, 0], [380, 100]]},
        "belt_moving": {
            "frames": [{"frame": f"{k}.png", "belt_position_mm": place} for k, place in _PLACES_MM.items()]
        },
    }
    for name, document in documents.items():
        (truth / f"{name}.json").write_text(json.dumps(document))
    rig = importlib.import_module("rendered_belt").read_rig(tmp_path)
    pixels = np.stack(np.meshgrid(np.arange(612.0), np.arange(512.0)), axis=-1)
    rays = np.concatenate([rig.core_camera.undistort(pixels), np.ones((512, 612, 1))], axis=-1)
    from_core = core_from_world.inverse()
    turned = rays @ from_core.rotation.T
    depth = (_HEIGHT_MM - from_core.translation_mm[2]) / turned[..., 2]
    x = from_core.translation_mm[0] + depth * turned[..., 0]
    for name in _PLACES_MM:
        label = np.where(np.abs(x) < 150, 2, 1).astype(np.uint8)
        np.savez(
            truth / f"belt_moving_{name}_depth_cam0.npz",
            z_distorted=depth.astype(np.float32),
            label_distorted=label,
        )
    return tmp_path


def test_heights_that_the_core_sees(rendered):
    """A place has the load's height where a frame's core sees it, at the belt's own position, and none elsewhere."""
    true = importlib.import_module("rendered_belt").read_seen_heights(rendered)
    known = np.isfinite(true.height_mm)
    np.testing.assert_allclose(true.height_mm[known], _HEIGHT_MM, atol=0.01)
    seen_mm = true.y_mm[known.any(axis=1)]
    for place_mm in _PLACES_MM.values():  # what lies under the core at a frame's time
        assert known[np.abs(true.y_mm + place_mm).argmin(), np.abs(true.x_mm) < 145].all()
    between = -np.mean(list(_PLACES_MM.values()))
    assert not ((seen_mm > between - 300) & (seen_mm < between + 300)).any()
    assert not known[:, np.abs(true.x_mm) > 152].any()
