"""The pairwise matcher: accuracy, missing images and invalid settings."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.errors import ReconstructionError, SettingsError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.evaluate.depth_scores import score_depth
from beltscape.stereo.pairwise.reconstructor import (
    PairwiseReconstructor,
    find_horizontal_auxiliary,
    reconstruct_pairwise,
)
from beltscape.stereo.settings import PairwiseSettings
from tests.stereo.raycast import compute_true_depth, make_world_rig, render_frame
from tests.stereo.rendered import needs_rendered, read_halved_frames, read_halved_rig, read_halved_truth
from tests.thorough import list_cases

SETTINGS = PairwiseSettings()
RANGE = (600.0, 780.0)


@pytest.fixture(scope="module")
def belt():
    rig, core_from_world = make_world_rig()
    return rig, render_frame(rig, core_from_world), compute_true_depth(rig, core_from_world)


@pytest.fixture(scope="module")
def measured(belt):
    return reconstruct_pairwise(belt[0], belt[1], SETTINGS, Silent(), depth_range_mm=RANGE)


def remove_cameras(frame_set: FrameSet, *names: str) -> FrameSet:
    return FrameSet(frame_set.frame, {n: i for n, i in frame_set.images.items() if n not in names})


def test_synthetic_belt_is_measured_without_bias_and_with_right_sigma(belt, measured):
    depth, truth = measured, belt[2]
    score = score_depth(depth, truth)
    assert score.within_1mm > 0.985
    assert score.interior_median_mm < 0.16
    assert abs(score.interior_bias_mm) < 0.03
    assert score.gross < 0.004
    assert 0.75 < score.sigma_ratio < 1.3
    assert depth.depth_mm.dtype == depth.sigma_mm.dtype == np.float32
    assert np.array_equal(np.isnan(depth.sigma_mm), np.isnan(depth.depth_mm))
    assert np.array_equal(depth.views == 0, np.isnan(depth.depth_mm))
    assert depth.confidence.dtype == np.float32
    np.testing.assert_array_equal(depth.confidence, depth.views / np.float32(4))


def test_mean_is_more_accurate_than_each_pair(belt, measured):
    rig, frames, truth = belt
    errors = [
        score_depth(
            reconstruct_pairwise(rig, frames, SETTINGS, Silent(), auxiliaries=(name,), depth_range_mm=RANGE),
            truth,
        ).interior_robust_sigma_mm
        for name in ("cam1", "cam2")
    ]
    assert score_depth(measured, truth).interior_robust_sigma_mm < 0.7 * min(errors)


@pytest.mark.parametrize("degrees", list_cases([90, 180, 225], [90, 225]))
def test_baselines_of_any_direction_are_measured(degrees):
    rig, core_from_world = make_world_rig(angles_deg=(degrees,))
    depth = reconstruct_pairwise(
        rig, render_frame(rig, core_from_world), SETTINGS, Silent(), depth_range_mm=RANGE
    )
    score = score_depth(depth, compute_true_depth(rig, core_from_world))
    assert score.within_1mm > 0.85
    assert abs(score.interior_bias_mm) < 0.06


def test_the_result_does_not_depend_on_the_number_of_threads(belt):
    rig, frames, _ = belt
    one, three = (
        PairwiseReconstructor(
            rig, RANGE, PairwiseSettings(threads=n), auxiliaries=("cam1", "cam2")
        ).reconstruct(frames, Silent())
        for n in (1, 3)
    )
    assert one.depth_mm.tobytes() == three.depth_mm.tobytes()
    assert one.sigma_mm.tobytes() == three.sigma_mm.tobytes()


def test_missing_auxiliary_is_left_out(belt):
    rig, frames, _ = belt
    matcher = PairwiseReconstructor(rig, RANGE, SETTINGS, auxiliaries=("cam1", "cam2"))
    depth = matcher.reconstruct(remove_cameras(frames, "cam2"), Silent())
    assert depth.views.max() == 1
    assert matcher.reconstruct(frames, Silent()).views.max() == 2


def test_sixteen_bit_and_colour_images_measure_as_eight_bit_grey_ones(belt):
    rig, frames, truth = belt
    deep = FrameSet("000", {n: i.astype(np.uint16) * 257 for n, i in frames.images.items()})
    coloured = FrameSet("000", {n: np.repeat(i[..., None], 3, axis=2) for n, i in frames.images.items()})
    scores = [
        score_depth(
            reconstruct_pairwise(rig, f, SETTINGS, Silent(), auxiliaries=("cam1",), depth_range_mm=RANGE),
            truth,
        ).interior_median_mm
        for f in (frames, deep, coloured)
    ]
    assert scores == pytest.approx([scores[0]] * 3, rel=0.02)


@pytest.mark.parametrize(
    ("missing", "message"),
    [
        (("cam0",), "frame 000: no usable image of the core camera cam0"),
        (("cam1", "cam2", "cam3", "cam4"), "frame 000: no usable image of an auxiliary camera"),
    ],
)
def test_error_names_the_missing_images(belt, missing, message):
    rig, frames, _ = belt
    with pytest.raises(ReconstructionError, match=message):
        reconstruct_pairwise(rig, remove_cameras(frames, *missing), SETTINGS, Silent(), depth_range_mm=RANGE)


def test_error_names_an_unknown_auxiliary(belt):
    with pytest.raises(ReconstructionError, match="cam9 is no auxiliary camera of the rig; there are cam1"):
        PairwiseReconstructor(belt[0], RANGE, SETTINGS, auxiliaries=("cam9",))


@pytest.mark.parametrize(("angles", "expected"), [((0, 90), "cam1"), ((80, 170, 250), "cam2")])
def test_the_binocular_pair_is_the_one_along_the_image_rows(angles, expected):
    assert find_horizontal_auxiliary(make_world_rig(angles_deg=angles)[0]) == expected


def test_one_camera_alone_has_no_binocular_pair():
    rig, _ = make_world_rig(angles_deg=())
    with pytest.raises(ReconstructionError, match="only its core camera cam0"):
        find_horizontal_auxiliary(Rig("cam0", rig.cameras, rig.cam_from_core))


@pytest.mark.parametrize(
    "wrong", [{"block_px": 4}, {"step_penalty": 50}, {"unknown": 1}, {"gradient_cap": 300}]
)
def test_invalid_settings_are_refused(wrong):
    with pytest.raises(SettingsError):
        PairwiseSettings(**wrong)


@pytest.mark.thorough
@needs_rendered
@pytest.mark.parametrize(
    ("scene", "labels", "within_1mm", "within_quarter_mm", "median_mm"),
    [
        ("belt_empty", (1,), 0.997, 0.96, 0.075),
        ("module", range(10, 19), 0.90, 0.80, 0.07),
        ("belt_loaded", (2,), 0.76, 0.46, 0.14),
    ],
)
def test_rendered_scenes_at_a_quarter_of_the_sensor_are_accurate(
    scene, labels, within_1mm, within_quarter_mm, median_mm
):
    truth, label = read_halved_truth(scene)
    depth = reconstruct_pairwise(
        read_halved_rig(), read_halved_frames(scene), SETTINGS, Silent(), depth_range_mm=(580, 775)
    )
    score = score_depth(depth, truth, np.isin(label, list(labels)))
    assert score.within_1mm > within_1mm
    assert score.within_quarter_mm > within_quarter_mm
    assert score.interior_median_mm < median_mm
    assert 0.8 < score.sigma_ratio < 1.25
