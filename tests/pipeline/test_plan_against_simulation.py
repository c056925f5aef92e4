"""A planned rig, simulated and measured: coverage and precision as the plan predicts."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.progress import Silent
from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.files.rig_json import read_rig, write_rig
from beltscape.files.tiff import read_float_tiff
from beltscape.pipeline.reconstructing.reconstruction import reconstruct_capture
from beltscape.pipeline.simulation import read_scenario, simulate
from beltscape.plan.plan import make_plan
from beltscape.plan.planned_rig import predict_sigma_map
from beltscape.plan.settings import PlanSettings, PrecisionSettings

SETTINGS = {
    "camera": {"size_px": (512, 432), "pitch_um": 3.45, "focal_mm": 1.6},
    "belt": {"width_mm": 650.0, "span_mm": 630.0, "flat_mm": 260.0, "material_mm": (0.0, 120.0)},
    "rig": {"auxiliaries": 3, "first_deg": 25.0, "height_mm": 640.0, "baseline_mm": 230.0},
}

MATCHING_SIGMA_PX = {"pairwise": 0.1, "multiview": 0.01}
"""What the plan's settings say the methods reach."""


def make_halved_plan():
    camera = {"size_px": (256, 216), "pitch_um": 6.9, "focal_mm": 1.6}
    return make_plan(PlanSettings.model_validate({**SETTINGS, "camera": camera}))


@pytest.fixture(scope="module")
def planned():
    return make_plan(PlanSettings.model_validate(SETTINGS))


def simulate_empty_belt(planned, folder, **render):
    """Render the planned rig's view of an empty belt; return its truth."""
    write_rig(folder / "planned.json", planned.planned.rig)
    overrides = {
        "seed": 11,
        "rig": {"file": str(folder / "planned.json"), "scale": 1.0, "height_mm": 640.0},
        "belt": {
            "width_mm": 650.0,
            "flat_mm": 260.0,
            "wing_deg": float(np.rad2deg(planned.settings.belt.trough_rad)),
        },
        "projector": {"covers_mm": 800.0, "position_mm": (40.0, -60.0, 660.0)},
        "render": {"ambient_samples": 1, **render},
    }
    simulate(read_scenario("belt_empty", overrides), folder / "capture", Silent())
    return np.load(folder / "capture" / "truth" / "belt_empty_depth.npz")


@pytest.fixture(scope="module")
def measured(planned, tmp_path_factory):
    folder = tmp_path_factory.mktemp("planned")
    truth = simulate_empty_belt(planned, folder, oversample=2, passes=2)
    rig = folder / "capture" / "truth" / "rig.json"
    for method in MATCHING_SIGMA_PX:
        reconstruct_capture(folder / "capture", read_rig(rig), folder / method, Silent(), method=method)
    return truth, {name: read_float_tiff(folder / name / "000" / "depth.tiff") for name in MATCHING_SIGMA_PX}


def check_coverage(planned, truth):
    belt = truth["label"] == 1
    camera = planned.planned.rig.core_camera
    half = planned.settings.belt.flat_mm / 2 / 640.0 * camera.focal_px[0]
    columns = (
        np.abs(np.arange(belt.shape[1]) - camera.center_px[0]) < half
    )  # the level middle: a plane of the plan
    for count in (1, 2, 3):
        seen = float((truth["views"] >= count)[belt & columns].mean())
        assert seen == pytest.approx(planned.planes[0].at_least[count], abs=0.02)


def test_predicted_coverage_is_reached_in_smaller_images(tmp_path):
    halved = make_halved_plan()
    check_coverage(halved, simulate_empty_belt(halved, tmp_path, oversample=1, passes=1))


@pytest.mark.thorough
def test_predicted_coverage_is_reached(planned, measured):
    check_coverage(planned, measured[0])


@pytest.mark.thorough
@pytest.mark.parametrize("method", MATCHING_SIGMA_PX)
def test_scatter_of_depth_equals_the_prediction(planned, measured, method):
    precision = PrecisionSettings(matching_sigma_px=MATCHING_SIGMA_PX[method])
    ratio = scatter_mm(measured, method) / promised_mm(planned, precision)
    assert 0.5 < ratio < 2.0


@pytest.mark.thorough
def test_scatter_of_depth_is_within_the_default_prediction(planned, measured):
    assert scatter_mm(measured, "multiview") < promised_mm(planned, PrecisionSettings())


def scatter_mm(measured, method: str) -> float:
    """Robust standard deviation of the depth's errors on the lit belt, where all cameras see it."""
    truth, depth = measured
    good = (truth["label"] == 1) & truth["lit"] & (truth["views"] == 3)
    error = (depth[method] - truth["depth_mm"])[good]
    return MAD_TO_SIGMA * float(np.nanmedian(np.abs(error - np.nanmedian(error))))


def promised_mm(planned, precision: PrecisionSettings) -> float:
    """The plan's depth σ there."""
    settings = planned.settings.model_copy(update={"precision": precision})
    length = planned.planes[0].core_length_mm
    return float(np.nanmedian(predict_sigma_map(settings, planned.planned, 0.0, length).sigma_mm))
