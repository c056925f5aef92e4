"""Frame folders of a reconstruction: exact round trip and missing files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from beltscape.core.cloud import PointCloud
from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.reconstruction import read_frame, write_frame
from beltscape.files.rig_json import write_rig
from beltscape.files.tiff import write_float_tiff

SIZE = (6, 4)


def depth_map() -> DepthMap:
    rng = np.random.default_rng(1)
    z = rng.uniform(600, 700, SIZE[::-1]).astype(np.float32)
    z[1, 2:5] = np.nan
    views = np.where(np.isfinite(z), rng.integers(1, 5, z.shape), 0).astype(np.uint8)
    sigma, confidence = (values.astype(np.float32) for values in (z / 5000, views / 4))
    return DepthMap(z, sigma, views, confidence)


@pytest.fixture
def frame(tmp_path: Path) -> Path:
    camera = Camera("cam0", SIZE, np.full(2, 8.0), np.array([2.5, 1.5]), np.zeros(5))
    write_rig(tmp_path / "rig.json", Rig("cam0", {"cam0": camera}, {"cam0": Pose.identity()}))
    none = np.empty((0, 3), np.float32)
    cloud = PointCloud(none, none, none.astype(np.uint8), none[:, 0])
    write_frame(tmp_path / "000", depth_map(), cloud, np.zeros((2, 2, 3), np.uint8))
    return tmp_path / "000"


def test_frame_reads_back_unchanged(frame):
    back, expected = read_frame(frame).depth, depth_map()
    for name in ("depth_mm", "sigma_mm", "views", "confidence"):
        values = getattr(back, name)
        assert values.dtype == getattr(expected, name).dtype
        np.testing.assert_array_equal(values, getattr(expected, name))


def test_confidence_is_one_where_measured_without_its_file(frame):
    (frame / "confidence.tiff").unlink()
    (frame / "views.png").unlink()
    depth = read_frame(frame).depth
    np.testing.assert_array_equal(depth.confidence, depth.measured)
    np.testing.assert_array_equal(depth.views, depth.measured)
    assert depth.confidence.dtype == np.float32


def test_a_map_of_another_size_is_named(frame):
    write_float_tiff(frame / "confidence.tiff", np.ones((2, 3), np.float32))
    with pytest.raises(InputError) as error:
        read_frame(frame)
    assert str(error.value) == (
        f"{frame}/confidence.tiff: 3×2 px, but the rig's core camera cam0 has 6×4; the rig.json beside the frame "
        "is another rig's"
    )
