"""A module in matched depth maps: every dimension within its σ, for both presets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from beltscape.core.frames import FrameSet, to_grey
from beltscape.core.progress import Silent
from beltscape.files.images import read_image
from beltscape.files.rig_json import read_rig
from beltscape.measure.features.measure import measure_module
from beltscape.measure.features.solids import render_nominal_view
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.pointcloud import undistort_image
from beltscape.stereo.settings import MultiviewSettings
from beltscape.target.module import read_module
from tests.synthetic.demo import DEMO, TRUE_RIG
from tests.synthetic.modules import DepthCameraView, module, module_pose, rig
from tests.thorough import list_rows

LIMITS_MM = {
    "length": 0.8, "width": 0.8, "edge": 1.2, "diameter": 3.0, "height": 0.05,
    "height_difference": 0.05,
}  # fmt: skip
"""At a quarter of the sensor's pixels (1.2 mm each)."""


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("preset", "radius_mm"), list_rows([("standard", 0.3), ("fast", 1.0)], [("fast", 1.0)])
)
def test_every_dimension_of_the_demo_is_within_its_sigma(preset, radius_mm):
    there = read_rig(TRUE_RIG)
    images = {name: read_image(DEMO / "module" / name / "000.png") for name in there.cameras}
    matcher = MultiviewReconstructor(there, (560.0, 780.0), MultiviewSettings.preset(preset))
    depth = matcher.reconstruct(FrameSet("000", images), Silent())
    image = to_grey(undistort_image(images[there.core], there.core_camera))
    measured = measure_module(depth, there, read_module(DEMO / "module.toml"), pattern=image)
    off = np.array([q.measured_mm - q.nominal_mm for q in measured.quantities])
    ratio = off / [q.sigma_mm for q in measured.quantities]
    names = [
        f"{q.name} {q.quantity} {o:+.3f} ± {q.sigma_mm:.3f}"
        for q, o in zip(measured.quantities, off, strict=True)
    ]
    assert np.nanmax(np.abs(ratio)) < 3.0, names
    assert np.sqrt(np.nanmean(ratio**2)) < 1.5, names
    limits = LIMITS_MM | {"radius": radius_mm}
    assert all(abs(o) < limits[q.quantity] for q, o in zip(measured.quantities, off, strict=True)), names


@pytest.mark.thorough
@pytest.mark.parametrize("reach_px", [-1, 0, 1])
def test_a_base_by_its_rim_alone_is_honest_however_far_the_matcher_reaches(reach_px):
    """Another preset, or a base as dark as the belt, lets the rim of all edges reach farther or less far, alike."""
    seen, pose = DepthCameraView(module(), module_pose(12, -8, 25)), module_pose(12, -8, 25)
    depth = seen.depth()
    base = render_nominal_view(module(), pose, rig().core_camera)
    module_px = base.label >= 0
    grown = ndimage.binary_dilation(module_px) if reach_px > 0 else ndimage.binary_erosion(module_px)
    changed = (grown != module_px) if reach_px else np.zeros_like(module_px)
    beside = changed | (module_px == (reach_px < 0))
    nearest = np.asarray(ndimage.distance_transform_edt(beside, return_distances=False, return_indices=True))
    moved = np.where(changed, depth.depth_mm[tuple(nearest)], depth.depth_mm)
    measured = measure_module(replace(depth, depth_mm=moved.astype(np.float32)), rig(), module())
    for q in measured.quantities:
        if q.name == "base":
            assert abs(q.measured_mm - q.nominal_mm) < 2.5 * q.sigma_mm, (q.measured_mm, q.sigma_mm)
