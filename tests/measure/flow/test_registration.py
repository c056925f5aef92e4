"""Registration of the load between two frames by its heights."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.measure.flow.belt_motion import EncoderScale
from beltscape.measure.flow.registration import HighPassHeights, compute_high_pass, register
from tests.measure.flow.moving_belt import CAMERA, Heap, depth_map, make_empty_belt
from tests.thorough import examples

HEAP = Heap(start_mm=-1500, end_mm=1500)
GROUND = make_empty_belt()
OVERLAP = 0.12


def seen(place_mm: float, heap: Heap | None = HEAP) -> HighPassHeights:
    height = GROUND.coarse(depth_map(heap, place_mm), 2)
    return compute_high_pass(height, 2 * GROUND.cell_mm, GROUND.belt.noise_mm)


@given(st.floats(20, 350), st.floats(-300, 300), st.sampled_from([-1, 1]))
@examples(6)
def test_motion_is_found_to_a_small_part_of_a_cell(step: float, start: float, way: int) -> None:
    shift = register(seen(start), seen(start + way * step), least_overlap=OVERLAP)
    assert shift is not None
    error = shift.along_mm - way * step
    assert abs(error) < 0.03 * 2 * GROUND.cell_mm
    assert abs(error) < 4 * shift.sigma_mm
    assert shift.sigma_mm < 0.05 * 2 * GROUND.cell_mm
    assert abs(shift.across_mm) < 0.03 * 2 * GROUND.cell_mm


def pattern_image(place_mm: float) -> np.ndarray:
    """(H, W) the core's image: dots from a projector beside it, on a grey heap without any texture."""
    rng = np.random.default_rng(1)
    texture = cv2.GaussianBlur(rng.uniform(0, 1, (400, 400)).astype(np.float32), (0, 0), 1.5)
    depth = depth_map(HEAP, place_mm, noise_mm=0.0).depth_mm.astype(np.float64)
    points = np.concatenate([CAMERA.rays() * depth[..., None], depth[..., None]], axis=-1)
    beside = points - np.array([60.0, 0.0, 0.0])
    u = 250 * beside[..., 0] / beside[..., 2] + 200
    v = 250 * beside[..., 1] / beside[..., 2] + 200
    return cv2.remap(texture, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR)


@pytest.mark.parametrize("step_mm", [40.0, 90.0])
def test_tracking_images_finds_the_standing_pattern_heights_find_the_belt(step_mm: float) -> None:
    before, after = pattern_image(0.0), pattern_image(step_mm)
    (_, rows), response = cv2.phaseCorrelate(before, after)
    pixel_mm = GROUND.cell_mm
    assert response > 0.1
    assert abs(rows * pixel_mm) < 0.1 * step_mm
    shift = register(seen(0.0), seen(step_mm), least_overlap=OVERLAP)
    assert shift is not None
    assert shift.along_mm == pytest.approx(step_mm, abs=0.2)


def test_empty_belt_gives_no_motion() -> None:
    assert register(seen(0.0, None), seen(100.0, None), least_overlap=OVERLAP) is None


def test_even_ribs_are_ambiguous_without_a_prediction() -> None:
    x, y = np.meshgrid(np.arange(-150, 150, 4.0), np.arange(-300, 300, 4.0))

    def ribs(moved: float) -> HighPassHeights:
        noise = 0.2 * np.random.default_rng(round(moved)).normal(size=x.shape)
        return compute_high_pass(
            30 + 5 * np.cos(2 * np.pi * (y - moved) / 60) + np.sin(x / 9) + noise, 4.0, 0.2
        )

    assert register(ribs(0), ribs(130), least_overlap=OVERLAP) is None
    shift = register(ribs(0), ribs(130), least_overlap=OVERLAP, near_mm=133.0)
    assert shift is not None
    assert shift.along_mm == pytest.approx(130, abs=0.3)


def test_encoder_scale_is_the_ratio_with_an_honest_sigma() -> None:
    rng = np.random.default_rng(4)
    errors = []
    for _ in range(60):
        scale = EncoderScale()
        for step in rng.uniform(80, 120, 25):
            scale.compare(1.01 * step, step + rng.normal(0, 0.1), 0.1)
        errors.append((scale.ratio - 1.01) / scale.sigma)
    assert np.std(errors) == pytest.approx(1.0, abs=0.35)
    assert EncoderScale().ratio == 1.0
