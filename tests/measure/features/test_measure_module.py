"""A module in exact depth maps: found anywhere, measured correctly, missing parts reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from beltscape.core.depth import DepthMap
from beltscape.core.errors import MeasureError
from beltscape.measure.features.face import estimate_correlation_area_px, fit_face
from beltscape.measure.features.measure import measure_module
from beltscape.measure.features.result import MeasuredModule
from beltscape.measure.features.solids import render_nominal_view
from tests.synthetic.modules import DepthCameraView, module, module_pose, rig
from tests.thorough import THOROUGH, examples

FLAT = ("height", "height_difference")


def errors(measured: MeasuredModule, *kinds: str) -> dict[str, float]:
    return {
        f"{q.name} {q.quantity}": q.measured_mm - q.nominal_mm
        for q in measured.quantities
        if not kinds or q.quantity in kinds
    }


OTHER_SIZES = module(
    cube=[
        {"name": "cube100", "edge_mm": 100.7, "center_mm": (-80, -42)},
        {"name": "cube60", "edge_mm": 59.2, "center_mm": (20, 52)},
        {"name": "cube40", "edge_mm": 40, "center_mm": (110, 66)},
    ],
    sphere=[{"name": "sphere70", "diameter_mm": 71, "center_mm": (90, -45)}],
)
"""A module that differs from its nominal sizes."""


@pytest.fixture(scope="module")
def exact() -> tuple[DepthMap, np.ndarray]:
    seen = DepthCameraView(OTHER_SIZES, module_pose(12, -8, 25))
    return seen.depth(), seen.render_brightness()


def test_exact_depth_and_a_plain_image_give_every_dimension_as_it_is(exact):
    depth, plain = exact
    measured = measure_module(depth, rig(), module(), plain=plain)
    assert len(measured.quantities) == 2 + 3 * 2 + 1 + 2 + 2
    truth = {
        "cube100 height": 0.7, "cube100 edge": 0.7, "cube60 height": -0.8, "cube60 edge": -0.8,
        "sphere70 radius": 0.5, "step:cube100-cube60 height_difference": 1.5,
        "step:cube60-cube40 height_difference": -0.8,
    }  # fmt: skip
    off = {name: error - truth.get(name, 0.0) for name, error in errors(measured).items()}
    assert set(truth) <= set(off)
    # a pixel is 1.2 mm here
    limits = dict.fromkeys(FLAT, 0.001) | {"radius": 0.005}
    assert all(abs(error) < limits.get(name.split()[-1], 0.2) for name, error in off.items()), off
    assert all(0 < q.sigma_mm < 0.6 for q in measured.quantities)
    assert all(q.points > 0 for q in measured.quantities)


def test_without_an_image_edges_are_those_of_the_depth_map_with_a_wide_sigma(exact):
    measured = measure_module(exact[0], rig(), module())
    for q in measured.quantities:
        if q.quantity in ("edge", "length", "width", "diameter"):
            assert (
                abs(q.measured_mm - q.nominal_mm) < 3.0
            )  # the matcher's reach, taken off, is not in exact depth
            assert q.sigma_mm > 0.4
    assert any("rim alone" in warning for warning in measured.warnings)
    assert any("image.png" in warning for warning in measured.warnings)


@pytest.mark.thorough
@examples(3)
@given(
    x=st.floats(-90, 90),
    y=st.floats(-60, 60),
    turn=st.floats(-180, 180),
    tilt=st.floats(-4, 4),
)
def test_dimensions_do_not_depend_on_the_pose(x, y, turn, tilt):
    true = module_pose(x, y, turn, tilt)
    measured = measure_module(DepthCameraView(module(), true).depth(), rig(), module())
    off = true.inverse() @ measured.core_from_module
    assert np.abs(off.translation_mm).max() < 0.3
    assert off.angle_deg < 0.2
    assert max(map(abs, errors(measured, *FLAT).values())) < 0.002
    assert max(map(abs, errors(measured, "radius").values())) < 0.01


@pytest.mark.thorough
def test_the_base_is_measured_where_cubes_hide_most_of_a_rim():
    """Only the upper right of the base shows that rim, as a narrow strip that the matcher did not measure."""
    tall = [
        {"name": "cube100", "edge_mm": 100, "center_mm": (-85, 42)},
        {"name": "cube80", "edge_mm": 80, "center_mm": (20, 52)},
        {"name": "cube60", "edge_mm": 60, "center_mm": (105, 58)},
    ]
    there = module(cube=tall, cylinder=[])
    seen = DepthCameraView(there, module_pose(0, 0, 10))
    depth = seen.depth()
    step = ndimage.maximum_filter(depth.depth_mm, 7) - ndimage.minimum_filter(depth.depth_mm, 7)
    left = replace(depth, depth_mm=np.where(step > 20, np.float32(np.nan), depth.depth_mm))
    measured = measure_module(left, rig(), there, plain=seen.render_brightness())
    found = {(q.name, q.quantity): q for q in measured.quantities}
    for key in (("base", "length"), ("base", "width"), ("cube100", "edge"), ("cube80", "edge")):
        assert abs(found[key].measured_mm - found[key].nominal_mm) < 0.2
        assert found[key].sigma_mm < 0.4


def test_what_is_not_there_is_named_and_left_out():
    left = [cube.model_dump() for cube in module().cube if cube.name != "cube60"]
    there = module(cube=left, cylinder=[])
    true = module_pose(-40, 30, 130, 3)
    measured = measure_module(DepthCameraView(there, true).depth(), rig(), module())
    off = true.inverse() @ measured.core_from_module
    assert np.abs(off.translation_mm).max() < 0.3
    assert off.angle_deg < 0.2
    by_name = {(q.name, q.quantity): q.measured_mm for q in measured.quantities}
    for lost in (("cube60", "height"), ("cube60", "edge"), ("rod", "height"), ("rod", "diameter")):
        assert np.isnan(by_name[lost])
    assert np.isnan(by_name["step:cube100-cube60", "height_difference"])
    assert by_name["cube100", "height"] == pytest.approx(100, abs=0.002)
    assert by_name["sphere70", "radius"] == pytest.approx(35, abs=0.01)
    text = " ".join(measured.warnings)
    assert all(f"{name}: not measured" in text for name in ("cube60", "rod"))
    assert "cube100: not" not in text


def test_another_module_is_not_taken_for_this_one():
    other = module(
        cube=[{"name": "cube90", "edge_mm": 90, "center_mm": (60, 30)}],
        sphere=[{"name": "sphere80", "diameter_mm": 80, "center_mm": (-60, -40)}],
        cylinder=[],
        base={"size_mm": (230, 180, 10)},
    )
    with pytest.raises(MeasureError, match=r"is this its module\.toml"):
        measure_module(DepthCameraView(other, module_pose(0, 0, 30)).depth(), rig(), module())


def test_a_frame_without_depth_shows_no_module():
    nothing = np.full((512, 612), np.nan, np.float32)
    zero = np.zeros(nothing.shape, np.float32)
    with pytest.raises(MeasureError, match="shows no plane"):
        measure_module(DepthMap(nothing, nothing, zero.astype(np.uint8), zero), rig(), module())


def test_sigma_of_a_height_is_what_correlated_noise_makes_of_it(exact):
    """The σ of a face's height covers errors that go together over several pixels."""
    depth, camera = exact[0], rig().core_camera
    view = render_nominal_view(OTHER_SIZES, module_pose(12, -8, 25), camera)
    ratios: list[float] = []
    for seed in range(12 if THOROUGH else 6):
        noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=view.label.shape), 2.0)
        noise *= 0.02 / noise.std()
        sigma = np.full_like(depth.sigma_mm, 0.02)
        noisy = DepthMap((depth.depth_mm + noise).astype(np.float32), sigma, depth.views, depth.confidence)
        faces = [fit_face(noisy, camera, view.face(label), view.depth_mm) for label in (0, 1, 2)]
        assert all(faces)
        base, *tops = [face for face in faces if face]
        grain = estimate_correlation_area_px([face.residual_mm for face in (base, *tops)])
        for top, true in zip(tops, (100.7, 59.2), strict=True):
            height, slope = base.height_above(top.middle_mm)
            variance = top.depth_variance(grain) + grain * slope @ base.covariance @ slope
            ratios.append(float((height - true) / np.sqrt(variance)))
    assert 0.7 < np.sqrt(np.mean(np.square(ratios))) < 1.4
