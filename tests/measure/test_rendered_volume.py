"""The belt frame and volumes on the rendered captures' exact depth, against the truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from beltscape.measure.belt.empty_belt import find_belt, learn_belt
from beltscape.measure.volume.settings import VolumeSettings
from beltscape.measure.volume.volume import measure_volume

TRUTH = Path(__file__).parents[3] / "shared/data/rendered/truth"
pytestmark = [
    pytest.mark.thorough,
    pytest.mark.skipif(not TRUTH.is_dir(), reason="the rendered captures are not beside the repository"),
]


def camera() -> Camera:
    matrix = np.array(json.loads((TRUTH / "rig.json").read_text())["cameras"]["cam0"]["K"])
    return Camera("cam0", (1224, 1024), np.diag(matrix)[:2].copy(), matrix[:2, 2].copy(), np.zeros(5))


def depth(scene: str) -> DepthMap:
    z = np.load(TRUTH / f"{scene}_depth_cam0.npz")["z_pinhole"].astype(np.float32)
    ones = np.ones(z.shape, np.float32)
    return DepthMap(z, 1e-3 * ones, 4 * ones.astype(np.uint8), ones)  # pyrefly: ignore[bad-argument-type]


def origin_mm() -> np.ndarray:
    """World point where the core camera's axis meets the flat belt, z = 0."""
    belt = json.loads((TRUTH / "belt.json").read_text())
    rotation, translation = np.array(belt["world_to_cam0_R"]), np.array(belt["world_to_cam0_t"])
    center, axis = -rotation.T @ translation, rotation[2]
    return center - axis * center[2] / axis[2]


def test_belt_frame_is_the_worlds_moved_to_the_optical_axis() -> None:
    belt = find_belt(depth("belt_empty"), camera())
    world = json.loads((TRUTH / "belt.json").read_text())
    rotation = belt.belt_from_core.rotation @ np.array(world["world_to_cam0_R"])
    assert np.abs(rotation - np.eye(3)).max() < 1e-5
    center = belt.belt_from_core.translation_mm + origin_mm()
    expected = -np.array(world["world_to_cam0_R"]).T @ np.array(world["world_to_cam0_t"])
    np.testing.assert_allclose(center, expected, atol=0.01)
    assert belt.flat_mm is not None
    np.testing.assert_allclose(np.array(belt.flat_mm) + origin_mm()[0], [-150, 150], atol=6)


# a step is placed to half a pixel; of the module's far sides a ledge of its base is hidden from the core camera
@pytest.mark.parametrize(("scene", "relative"), [("belt_loaded", 0.006), ("module", 0.018)])
def test_volume_from_exact_depth(scene: str, relative: float) -> None:
    truth = json.loads((TRUTH / f"{scene}_volume.json").read_text())
    low, high = (y - origin_mm()[1] for y in truth["y_range"])
    found = measure_volume(
        depth(scene),
        learn_belt([depth("belt_empty")], camera()),
        camera(),
        VolumeSettings(),
        across_mm=None,
        along_mm=(low, high),
    )
    error = found.volume_mm3 - truth["volume_mm3"]
    assert abs(error) <= relative * truth["volume_mm3"]
    assert abs(error) <= 2 * found.sigma_mm3
    assert found.sigma_mm3 <= 0.04 * truth["volume_mm3"]
    assert sum(p.area_mm2 for p in found.profiles) * 400 / 8 == pytest.approx(found.volume_mm3, rel=1e-6)
