"""Choice of the lens model: Brown's by default, another where held-out views or a turning polynomial ask for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.calibration.assessment.lens_domain import limit_domain
from beltscape.calibration.detection.corners import BoardDetections, Corners, has_planar_extent
from beltscape.calibration.intrinsics.lens_choice import (
    MIN_CHOICE_VIEWS,
    calibrate_with_model,
    describe_choices,
    turns_within_image,
)
from beltscape.calibration.intrinsics.lens_fits import refit_radially
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.files.camera_types import CameraType
from tests.thorough import list_cases

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


def views_facing(lens, count, seed):
    """Corners of boards that are turned towards a wide lens, their middles all over the image."""
    rng = np.random.default_rng(seed)
    size, middle, views = lens.size_px, BOARD_MM.mean(axis=0), {}
    while len(views) < count:
        ray = np.append(lens.undistort(rng.uniform(0, size, (1, 2)))[0], 1.0)
        if not np.isfinite(ray).all():
            continue
        ray /= np.linalg.norm(ray)
        across = np.cross([0, 1, 0], ray) / np.linalg.norm(np.cross([0, 1, 0], ray))
        facing = np.column_stack([across, np.cross(ray, across), ray])
        turn = Pose.of(rng.uniform(-0.7, 0.7, 3) * [1, 1, 0.5], np.zeros(3)).rotation
        distance = 240.0 * lens.focal_px[0] / (0.3 * size[0] * rng.uniform(0.6, 1.4))
        in_camera = (BOARD_MM - middle) @ (facing @ turn).T + distance * ray
        with np.errstate(invalid="ignore"):
            pixels = lens.project(in_camera)
            inside = (in_camera[:, 2] > 0) & ((pixels >= 0) & (pixels <= np.array(size) - 1)).all(axis=1)
        ids = np.flatnonzero(inside)
        if len(ids) >= 20 and has_planar_extent(BOARD_MM[ids]):
            views[f"{len(views):02d}"] = Corners(ids, pixels[ids] + rng.normal(0, NOISE_PX, (len(ids), 2)))
    return BoardDetections({"c": size}, {"c": views}, {"c": count})


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


@pytest.mark.parametrize(
    ("true", "model"), [(WIDE, "rational"), pytest.param(FISHEYE, "fisheye", marks=pytest.mark.thorough)]
)
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


def test_a_polynomial_that_turns_back_beyond_the_views_stays():
    """Barrel distortion of a webcam, seen in the middle of the image: others fit no better, so nothing changes."""
    webcam = camera(480.0, [-0.42, 0.0, 1e-3, -5e-4, 0.0])
    seen = views_of(webcam, 20, distance_mm=450.0)
    inner = {
        frame: view.select(np.linalg.norm(view.pixels - webcam.center_px, axis=1) < 200)
        for frame, view in seen.views["c"].items()
    }
    inner = {frame: view for frame, view in inner.items() if len(view) >= 20}
    assert len(inner) >= MIN_CHOICE_VIEWS
    found, choice = calibrate_with_model("c", BoardDetections({"c": SIZE}, {"c": inner}, {"c": 20}), BOARD_MM)
    assert turns_within_image(found.camera)
    assert choice.model == found.camera.model == "brown"
    assert choice.reason.startswith("no other model is clearly better (")


@pytest.mark.thorough
def test_a_very_wide_lens_is_found_from_a_bad_first_focal_length():
    """Boards at the rim hide the focal length from the equidistant starts: the best of them leads to 107 px."""
    wide = Camera("c", (1280, 1024), np.full(2, 410.0), np.array([645.0, 508.0]), WIDE.distortion, "rational")
    seen = views_facing(wide, 12, seed=5)
    found, choice = calibrate_with_model("c", seen, BOARD_MM)
    assert choice.model == "rational"
    assert found.rms_px < 1.6 * NOISE_PX


TILTED = camera(1400.0, [-0.2, 0.1, 2e-4, -1e-4, *[0.0] * 8, 0.09, -0.06], "tilted")


@pytest.mark.parametrize("requested", list_cases(["auto", "tilted"], {"auto"}))
def test_a_tilted_sensor_is_recovered_with_its_sigma(requested):
    found, choice = calibrate_with_model("c", views_of(TILTED, 24, distance_mm=1100.0), BOARD_MM, requested)
    assert choice.model == found.camera.model == "tilted"
    assert found.rms_px < 1.6 * NOISE_PX
    for name, angle, true in zip(
        ("tau_x", "tau_y"), found.camera.distortion[-2:], (0.09, -0.06), strict=True
    ):
        assert 1e-4 < found.sigma[name] < 0.02
        assert abs(angle - true) < 3 * found.sigma[name]


def test_a_stated_lens_model_is_taken_instead_of_a_choice():
    seen = replace(views_of(LONG, distance_mm=600.0), types={"c": CameraType(lens_model="tilted")})
    found, choice = calibrate_with_model("c", seen, BOARD_MM)
    assert (choice.model, choice.reason) == ("tilted", "as asked for")
    assert np.abs(found.camera.distortion[-2:]).max() < 3 * found.sigma["tau_x"]


def test_a_shifted_sensor_is_not_taken_for_a_tilted_one():
    """The part of a sensor that is read out may lie off the axis; nothing but the middle changes."""
    shifted = Camera("c", SIZE, LONG.focal_px, np.array([390.0, 300.0]), LONG.distortion)
    found, choice = calibrate_with_model("c", views_of(shifted, distance_mm=600.0), BOARD_MM)
    assert choice.model == found.camera.model == "brown"
    assert choice.reason.startswith("no other model is clearly better (tilted: ")


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
