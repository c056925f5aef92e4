"""Detection of markers in drawn speckle under any exposure, white balance and view; none without markers."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from beltscape.files.images import read_image
from beltscape.stereo.markers.detection import detect_markers
from beltscape.stereo.markers.grid import detect_marker_grid
from tests.stereo.projected import MARKERS, compute_luminance, make_view, project_points, render_pattern
from tests.stereo.rendered import RENDERED, needs_rendered


def _distances(detected: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Return the (M,) distances from every true centre to the nearest detected one."""
    return np.linalg.norm(true.reshape(-1, 1, 2) - detected, axis=-1).min(axis=1)


@pytest.mark.parametrize(
    ("exposure", "cast"),
    [
        pytest.param(1.0, (1.0, 1.0, 1.0), marks=pytest.mark.thorough),
        (0.3, (1.0, 1.0, 1.0)),
        pytest.param(2.0, (1.0, 1.0, 1.0), marks=pytest.mark.thorough),
        (0.8, (0.6, 1.0, 1.5)),
        pytest.param(1.0, (1.4, 0.7, 0.8), marks=pytest.mark.thorough),
    ],
)
def test_detection_does_not_depend_on_exposure_and_white_balance(exposure, cast):
    image_from_pattern = make_view(slant=0.15)
    markers = detect_markers(render_pattern(image_from_pattern, exposure=exposure, cast=cast))
    assert len(markers) == 16
    assert _distances(markers.center_px, project_points(MARKERS, image_from_pattern)).max() < 0.35
    assert markers.confidence.min() > 0.5


def test_detection_in_sixteen_bits_equals_that_in_eight():
    image = render_pattern(make_view())
    deep = image.astype(np.uint16) * 16  # 12 bits in 16
    eight, sixteen = detect_marker_grid(image), detect_marker_grid(deep)
    assert eight is not None and sixteen is not None
    assert eight.count == sixteen.count == 16
    np.testing.assert_allclose(sixteen.center_px, eight.center_px, atol=0.05)


@pytest.mark.parametrize(
    ("size_px", "exposure"),
    [
        ((816, 680), 0.6),
        pytest.param((816, 680), 1.0, marks=pytest.mark.thorough),
        pytest.param((816, 680), 2.0, marks=pytest.mark.thorough),
        pytest.param((1224, 1024), 1.0, marks=pytest.mark.thorough),
        pytest.param((1224, 1024), 0.6, marks=pytest.mark.thorough),
        pytest.param((1224, 1024), 2.0, marks=pytest.mark.thorough),
    ],
)
def test_markers_are_detected_in_grey_images(exposure, size_px):
    image_from_pattern = make_view(size_px)
    markers = detect_markers(
        compute_luminance(render_pattern(image_from_pattern, size_px, exposure=exposure))
    )
    assert len(markers) == 16
    distances = _distances(markers.center_px, project_points(MARKERS, image_from_pattern))
    assert distances.max() < 1.2 * size_px[0] / 1224 + 0.3


def test_grey_image_stored_as_rgb_is_treated_as_grey():
    grey = compute_luminance(render_pattern(make_view()))
    one, three = detect_markers(grey), detect_markers(np.repeat(grey[..., None], 3, axis=2))
    np.testing.assert_array_equal(one.center_px, three.center_px)
    assert len(one) == 16


def test_image_without_projector_has_no_markers():
    image = render_pattern(make_view(), speckle=False, ambient=60.0, noise=2.0)
    assert detect_marker_grid(image) is None
    assert detect_marker_grid(compute_luminance(image)) is None


def test_stones_without_speckle_are_not_detected():
    rng = np.random.default_rng(3)
    stones = np.full((680, 816), 20, np.uint8)
    for _ in range(300):
        u, v = rng.uniform(0, (816, 680)).astype(int)
        cv2.circle(stones, (int(u), int(v)), int(rng.integers(6, 26)), int(rng.integers(15, 90)), -1)
    noisy = np.clip(stones + rng.normal(0, 1.5, stones.shape), 0, 255).astype(np.uint8)
    assert detect_marker_grid(noisy) is None


def test_disc_with_a_dark_half_keeps_its_centre():
    """The disc lies over the edge of a white module on black rubber."""
    image_from_pattern = make_view()
    image = render_pattern(image_from_pattern, noise=0.5).astype(float)
    center = project_points(MARKERS, image_from_pattern)[1, 1]
    image[:, : int(center[0])] *= 0.15
    markers = detect_markers(np.rint(image).astype(np.uint8))
    assert _distances(markers.center_px, center).max() < 1.2


def test_half_a_disc_has_less_confidence_than_a_whole_one():
    image_from_pattern = make_view()
    image = render_pattern(image_from_pattern)
    u, v = project_points(MARKERS, image_from_pattern)[2, 1].astype(int)
    image[v - 20 : v + 20, u : u + 20] = 6  # in shadow
    markers = detect_markers(image)
    nearest = int(np.argmin(np.linalg.norm(markers.center_px - [u, v], axis=1)))
    assert markers.confidence[nearest] < 0.7 * np.median(markers.confidence)
    assert markers.radius_px[nearest] < 0.85 * np.median(markers.radius_px)


@pytest.mark.thorough
@needs_rendered
@pytest.mark.parametrize("scene", ["module_nospeckle", "belt_loaded_nospeckle"])
def test_rendered_scenes_without_speckle_have_no_grid(scene):
    for camera in range(5):
        assert detect_marker_grid(read_image(RENDERED / scene / f"cam{camera}/000.png")) is None
