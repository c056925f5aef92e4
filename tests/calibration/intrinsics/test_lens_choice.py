"""Choice of the lens model: Brown's by default, another where held-out views or a turning polynomial ask for it."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.calibration.assessment.domain.lens_domain import limit_domain
from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.calibration.intrinsics.lens_choice import (
    MIN_CHOICE_VIEWS,
    calibrate_with_model,
    describe_choices,
    turns_within_image,
)
from beltscape.calibration.intrinsics.lens_starts import refit_radially
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose

SIZE = (640, 512)
BOARD_MM = (
    np.stack([*np.meshgrid(np.arange(9) * 30.0, np.arange(7) * 30.0), np.zeros((7, 9))], -1)
    .reshape(-1, 3)
    .astype(np.float64)
)
NOISE_PX = 0.03


def camera(focal, lens, model="brown"):
    return Camera("c", SIZE, np.full(2, focal), np.array([320.0, 250.0]), np.array(lens), model)


LONG = camera(800.0, [-0.1, 0.08, 1e-3, -5e-4, 0.0])
WIDE = camera(310.0, [0.9, 0.2, 3e-4, -2e-4, 0.01, 1.25, 0.45, 0.05], "rational")
FISHEYE = camera(230.0, [0.02, -0.01, 0.003, -0.001], "fisheye")


def views_of(lens, count=14, seed=1, distance_mm=300.0):
    """Corners of boards all over the image, with noise."""
    rng = np.random.default_rng(seed)
    middle, views = BOARD_MM.mean(axis=0), {}
    reach = min(SIZE[0] / 2 / lens.focal_px[0], 1.8)
    while len(views) < count:
        depth = distance_mm * rng.uniform(0.6, 1.4)
        place = np.append(rng.uniform(-1, 1, 2) * [reach, 0.8 * reach], 1.0) * depth
        rotation = Pose.of(rng.uniform(-0.6, 0.6, 3), np.zeros(3)).rotation
        pixels = lens.project((BOARD_MM - middle) @ rotation.T + place)
        with np.errstate(invalid="ignore"):
            seen = np.flatnonzero(((pixels >= 0) & (pixels <= np.array(SIZE) - 1)).all(axis=1))
        if len(seen) >= 20:
            noise = rng.normal(0, NOISE_PX, (len(seen), 2))
            views[f"{len(views):02d}"] = Corners(seen, pixels[seen] + noise)
    return BoardDetections({"c": SIZE}, {"c": views}, {"c": count})


def error_px(found, true, radius_px=300.0):
    """Largest distance of a direction's pixels under two lenses, within a radius of the image, px."""
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    for share in (0.3, 0.6, 1.0):
        pixels = true.center_px + share * radius_px * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        rays = np.column_stack([true.undistort(pixels), np.ones(len(angle))])
        yield float(np.abs(found.project(rays) - pixels).max())


def test_a_long_lens_keeps_browns_model_without_a_comparison():
    seen = views_of(LONG, distance_mm=600.0)
    found, choice = calibrate_with_model("c", seen, BOARD_MM)
    assert (found.camera.model, choice.reason, choice.held_out_px) == ("brown", "", {})
    assert describe_choices([choice]) == []
    assert limit_domain(found.camera, seen.views["c"]["00"].pixels).valid_radius_px is None


@pytest.mark.parametrize(("true", "model"), [(WIDE, "rational"), (FISHEYE, "fisheye")])
def test_a_wide_lens_gets_the_model_that_describes_it(true, model):
    seen = views_of(true)
    found, choice = calibrate_with_model("c", seen, BOARD_MM)
    assert found.camera.model == choice.model == model
    assert found.rms_px < 1.6 * NOISE_PX
    assert choice.held_out_px[model] < 1.8 * NOISE_PX
    assert not turns_within_image(found.camera)
    assert max(error_px(found.camera, true)) < 0.3
    (line,) = describe_choices([choice])
    assert line.startswith(f"camera c: lens model {model}: ")
    assert "held-out RMS 0.0" in line
    pixels = np.concatenate([view.pixels for view in seen.views["c"].values()])
    limited = limit_domain(found.camera, pixels)
    reach = np.linalg.norm(pixels - found.camera.center_px, axis=1).max()
    assert limited.valid_radius_px is None or limited.valid_radius_px == pytest.approx(reach, abs=0.01)


def test_a_requested_model_is_taken():
    found, choice = calibrate_with_model("c", views_of(LONG, distance_mm=600.0), BOARD_MM, "rational")
    assert (found.camera.model, choice.model) == ("rational", "rational")
    assert found.rms_px < 1.6 * NOISE_PX
    brown, _ = calibrate_with_model("c", views_of(WIDE), BOARD_MM, "brown")
    assert brown.camera.model == "brown"
    assert brown.rms_px > 3 * NOISE_PX


def test_few_views_compare_nothing_and_none_are_refused():
    few = views_of(WIDE, MIN_CHOICE_VIEWS - 1)
    assert calibrate_with_model("c", few, BOARD_MM)[0].camera.model == "brown"
    for model in ("auto", "fisheye"):
        with pytest.raises(CalibrationError, match=r"camera c sees the board in 2 of 2 images; at least 3"):
            calibrate_with_model("c", views_of(WIDE, 2), BOARD_MM, model)


def test_a_turning_polynomial_is_limited_before_it_turns():
    turning = camera(310.0, [-0.35, 0, 0, 0, 0])
    assert turns_within_image(turning)
    limited = limit_domain(turning, np.array([[0.0, 0.0]]))
    assert limited.valid_radius_px is not None
    assert limited.valid_radius_px < 310 * turning.valid_radius * (1 - 0.35 * turning.valid_radius**2)
    assert np.isfinite(
        limited.undistort(limited.center_px + np.array([0.99 * limited.valid_radius_px, 0]))
    ).all()


def test_a_fisheye_is_refitted_as_a_rational_lens():
    refitted = refit_radially(FISHEYE, "rational", 300.0)
    assert refitted.model == "rational"
    assert max(error_px(refitted, FISHEYE)) < 4.0  # a start
