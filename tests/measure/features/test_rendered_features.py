"""The rendered module: edges located in its images, with its exact depth, against the truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.frames import to_grey
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.images import read_image
from beltscape.measure.features.measure import measure_module
from beltscape.stereo.pointcloud import undistort_image
from beltscape.target.module import read_module

RENDERED = Path(__file__).parents[4] / "shared/data/rendered"
pytestmark = [
    pytest.mark.thorough,
    pytest.mark.skipif(not RENDERED.is_dir(), reason="the rendered captures are not beside the repository"),
]


def rig() -> Rig:
    truth = json.loads((RENDERED / "truth/rig.json").read_text())["cameras"]["cam0"]
    matrix, distortion = np.array(truth["K"]), np.array(truth["dist"]).ravel()[:5]
    camera = Camera("cam0", (1224, 1024), np.diag(matrix)[:2].copy(), matrix[:2, 2].copy(), distortion)
    return Rig("cam0", {"cam0": camera}, {"cam0": Pose.identity()})


# exact depth lacks the matcher's reach beyond edges, which is taken off: with dots the depth's say counts
@pytest.mark.parametrize(
    ("scene", "edge_mm", "base_mm", "rod_mm"),
    [("module", 0.6, 0.4, 0.6), ("module_nospeckle", 0.15, 0.2, 0.2)],
)
def test_dimensions(scene, edge_mm, base_mm, rod_mm):
    z = np.load(RENDERED / "truth/module_depth_cam0.npz")["z_pinhole"].astype(np.float32)
    ones = np.ones(z.shape, np.float32)
    depth = DepthMap(z, 2e-3 * ones, 4 * ones.astype(np.uint8), ones)  # pyrefly: ignore[bad-argument-type]
    image = to_grey(undistort_image(read_image(RENDERED / scene / "cam0/000.png"), rig().core_camera))
    measured = measure_module(depth, rig(), read_module(RENDERED / "module.toml"), plain=image)
    limits = {
        "edge": edge_mm, "length": base_mm, "width": base_mm, "diameter": rod_mm, "radius": 0.01,
        "height": 0.005, "height_difference": 0.005,
    }  # fmt: skip
    for q in measured.quantities:
        assert abs(q.measured_mm - q.nominal_mm) < limits[q.quantity], (q.name, q.quantity)
        assert abs(q.measured_mm - q.nominal_mm) < 4 * q.sigma_mm
