"""The multi-view matcher on ray-cast belts: accuracy, calibration of sigma, and reproducibility."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.evaluate.depth_scores import score_depth
from beltscape.kernels import load
from beltscape.kernels.native import levels
from beltscape.stereo import settings as multiview_settings
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.settings import MultiviewSettings
from tests.kernels.rounding import first_alike
from tests.stereo.raycast import compute_true_depth, make_camera, make_world_rig, render_frame
from tests.stereo.scenes import compute_depth_mm, make_ring, patch, plane, quantise, render_images
from tests.thorough import list_cases

RANGE = (600.0, 780.0)
ONE_THREAD = MultiviewSettings(threads=1)


@pytest.fixture(scope="module")
def belt():
    rig, core_from_world = make_world_rig()
    return rig, render_frame(rig, core_from_world), compute_true_depth(rig, core_from_world)


class StepRecorder(Silent):
    """Keeps the steps of a reconstruction."""

    def __init__(self):
        self.steps = []

    def step(self, stage, done, total):
        self.steps.append((stage, done, total))


@pytest.fixture(scope="module")
def run(belt):
    """Depth of the belt and the steps to it."""
    recorder = StepRecorder()
    return MultiviewReconstructor(belt[0], RANGE, ONE_THREAD).reconstruct(belt[1], recorder), recorder.steps


@pytest.fixture(scope="module")
def measured(run):
    return run[0]


def reconstruct(rig, frame_set, settings=ONE_THREAD, depth_range_mm=RANGE, **more) -> DepthMap:
    return MultiviewReconstructor(rig, depth_range_mm, settings, **more).reconstruct(frame_set, Silent())


def same_bytes(a: DepthMap, b: DepthMap) -> bool:
    return all(
        np.asarray(getattr(a, f.name)).tobytes() == np.asarray(getattr(b, f.name)).tobytes()
        for f in fields(DepthMap)
    )


ARRANGEMENTS: dict[str, tuple[dict[str, Any], float, float]] = {
    "one beside": ({"angles_deg": (0,)}, 0.93, 0.11),
    "one above": ({"angles_deg": (90,)}, 0.9, 0.11),
    "one diagonal": ({"angles_deg": (225,)}, 0.92, 0.11),
    "two opposite": ({"angles_deg": (0, 180)}, 0.99, 0.065),
    "two diagonal": ({"angles_deg": (45, 135)}, 0.98, 0.08),
    "four": ({}, 0.99, 0.05),
    "four diagonal": ({"angles_deg": (45, 135, 225, 315)}, 0.99, 0.05),
    "seven": ({"angles_deg": (0, 51, 103, 154, 206, 257, 309)}, 0.99, 0.04),
    "two parallel": ({"angles_deg": (30, 210), "parallel": True, "baseline_mm": 120}, 0.95, 0.14),
    "four parallel": ({"parallel": True, "baseline_mm": 120}, 0.99, 0.09),
}


FEW = ("one above", "two parallel")


@pytest.mark.parametrize("name", list_cases(ARRANGEMENTS, FEW))
def test_belt_is_accurate_with_any_arrangement_of_auxiliaries(name):
    arrangement, within_1mm, median_mm = ARRANGEMENTS[name]
    rig, core_from_world = make_world_rig(**arrangement)
    depth = reconstruct(rig, render_frame(rig, core_from_world))
    score = score_depth(depth, compute_true_depth(rig, core_from_world))
    assert score.within_1mm > within_1mm
    assert score.interior_median_mm < median_mm
    assert abs(score.interior_bias_mm) < 0.02
    assert score.gross < 0.002
    assert score.interior_gross < 0.001
    assert 0.6 < score.sigma_ratio < 1.75
    assert depth.views.max() == len(rig.auxiliaries)


@pytest.mark.parametrize(
    ("preset", "within_1mm", "median_mm"),
    [("fast", 0.93, 0.25), ("standard", 0.99, 0.05)],
)
def test_presets_are_accurate_on_a_noisy_colour_frame(preset, within_1mm, median_mm):
    """The pattern appears in one channel only."""
    rig, core_from_world = make_world_rig()
    rng = np.random.default_rng(6)
    images = {
        name: np.stack([image, *rng.integers(8, 12, (2, *image.shape), np.uint8)], axis=-1)
        for name, image in render_frame(rig, core_from_world, noise_counts=2.0).images.items()
    }
    settings = MultiviewSettings.preset(preset).model_copy(update={"threads": 1})
    score = score_depth(
        reconstruct(rig, FrameSet("000", images), settings), compute_true_depth(rig, core_from_world)
    )
    assert score.within_1mm > within_1mm
    assert score.interior_median_mm < median_mm
    assert abs(score.interior_bias_mm) < 0.04
    assert score.gross < 0.003
    assert 0.6 < score.sigma_ratio < 1.6


def test_depth_map_is_consistent_at_unmeasured_pixels(measured):
    unmeasured = ~measured.measured
    assert [getattr(measured, f.name).dtype for f in fields(DepthMap)[:4]] == [
        np.float32, np.float32, np.uint8, np.float32,
    ]  # fmt: skip
    assert np.array_equal(np.isnan(measured.sigma_mm), unmeasured)
    assert np.array_equal(measured.views == 0, unmeasured)
    assert np.array_equal(measured.confidence == 0, unmeasured)
    assert measured.confidence.max() <= 1
    assert (measured.sigma_mm[~unmeasured] > 0).all()


@pytest.mark.parametrize("threads", list_cases([1, 2, 3], [3]))
def test_depth_map_does_not_depend_on_the_number_of_threads(belt, measured, threads):
    assert same_bytes(reconstruct(belt[0], belt[1], MultiviewSettings(threads=threads)), measured)


def test_depth_map_does_not_depend_on_the_previous_frame(belt, measured):
    rig, frames, _ = belt
    matcher = MultiviewReconstructor(rig, RANGE, ONE_THREAD)
    few = FrameSet("000", {name: frames.images[name][::-1].copy() for name in ("cam0", "cam3")})
    matcher.reconstruct(few, Silent())
    assert same_bytes(matcher.reconstruct(frames, Silent()), measured)


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["16 bit", "colour"])
def test_sixteen_bit_and_colour_images_measure_as_eight_bit_grey_ones(belt, measured, kind):
    rig, frames, truth = belt
    images = {
        name: image.astype(np.uint16) * 257 if kind == "16 bit" else np.repeat(image[..., None], 3, axis=2)
        for name, image in frames.images.items()
    }
    depth = reconstruct(rig, FrameSet("000", images))
    assert score_depth(depth, truth).interior_median_mm == pytest.approx(
        score_depth(measured, truth).interior_median_mm, rel=0.02
    )
    assert (depth.measured == measured.measured).mean() > 0.999


@pytest.mark.parametrize("bits", list_cases([10, 12], [12]))
def test_ten_and_twelve_bits_in_sixteen_are_as_accurate(belt, bits):
    rig, frames, truth = belt
    images = {name: image.astype(np.uint16) << (bits - 8) for name, image in frames.images.items()}
    score = score_depth(reconstruct(rig, FrameSet("000", images)), truth)
    assert score.within_1mm > 0.99
    assert score.interior_median_mm < 0.05
    assert 0.6 < score.sigma_ratio < 1.6


def test_auxiliaries_of_other_sizes_are_accurate():
    alike = make_ring(size_px=(240, 200))
    others = {"cam1": (360, 300), "cam3": (160, 134)}
    cameras = {name: make_camera(name, others.get(name, (240, 200))) for name in alike.cameras}
    rig, solids = Rig("cam0", cameras, alike.cam_from_core), (plane(760), patch(680, (-150, 60), (-120, 120)))
    images = {n: quantise(i) for n, i in render_images(rig, solids, noise=1.0, dot_px=1.8).items()}
    depth = reconstruct(rig, FrameSet("000", images), depth_range_mm=(620, 820))
    score = score_depth(depth, compute_depth_mm(rig, solids))
    assert score.within_1mm > 0.95
    assert score.interior_median_mm < 0.15
    assert depth.views.max() == 4


def test_auxiliaries_that_are_not_selected_are_not_used(belt):
    rig, frames, _ = belt
    few = FrameSet("000", {name: frames.images[name] for name in ("cam0", "cam1", "cam3")})
    selected = reconstruct(rig, frames, auxiliaries=("cam1", "cam3"))
    assert same_bytes(selected, reconstruct(rig, few))
    assert selected.views.max() == 2


def test_wider_depth_range_gives_the_same_surface(belt, measured):
    wide = reconstruct(belt[0], belt[1], depth_range_mm=(420, 1300))
    both = wide.measured & measured.measured
    assert both.mean() > 0.99
    assert (np.abs(wide.depth_mm - measured.depth_mm)[both] < 0.1).mean() > 0.98


@pytest.fixture(scope="module")
def tiny():
    """Rig, frame and depth of 48 × 36 px, since the reference kernels are slow."""
    rig, solids = make_ring((0, 180), size_px=(48, 36)), (plane(760), patch(680, (-120, 120), (-100, 100)))
    images = {name: quantise(image) for name, image in render_images(rig, solids, noise=1.0).items()}
    return rig, FrameSet("000", images), compute_depth_mm(rig, solids)


def test_reference_kernels_give_the_depth_of_the_native_ones(tiny):
    rig, frames, truth = tiny
    native, reference = (
        reconstruct(rig, frames, depth_range_mm=(620, 820), kernels=load(name))
        for name in ("native", "reference")
    )
    assert np.median(np.abs(native.depth_mm - truth)[native.measured]) < 1
    assert (native.measured == reference.measured).mean() > 0.99
    both = native.measured & reference.measured
    assert (np.abs(native.depth_mm - reference.depth_mm)[both] < 0.01).mean() > 0.98
    assert np.quantile(np.abs(native.sigma_mm / reference.sigma_mm - 1)[both], 0.98) < 0.02


def test_instruction_sets_of_equal_rounding_give_equal_bytes(tiny):
    rig, frames, _ = tiny
    runs = {
        name: reconstruct(rig, frames, depth_range_mm=(620, 820), kernels=load(name)) for name in levels()
    }
    best = runs[levels()[-1]]
    for name, run in runs.items():
        assert same_bytes(runs[first_alike(name)], run)
        assert (run.measured == best.measured).mean() > 0.995
        both = run.measured & best.measured
        # pixels that rounding makes uncertain change their neighbours by message passing
        assert (np.abs(run.depth_mm - best.depth_mm)[both] < 0.01).mean() > 0.98


@pytest.mark.parametrize("preset", ["fast", "standard"])
def test_size_that_blocks_do_not_divide_is_measured_without_the_rest(preset, monkeypatch):
    monkeypatch.setattr(multiview_settings, "_LEAST_WIDTH_PX", 32)  # allows blocks in small images
    rig, solids = make_ring(size_px=(163, 121)), (plane(700, 0.1, 0.1),)
    frames = FrameSet(
        "000", {name: quantise(image) for name, image in render_images(rig, solids, noise=1.0).items()}
    )
    depth = reconstruct(rig, frames, MultiviewSettings.preset(preset))
    whole = (120, 162) if preset == "fast" else (121, 163)
    assert depth.depth_mm.shape == (121, 163)
    assert not depth.measured[whole[0] :].any()
    assert not depth.measured[:, whole[1] :].any()
    assert depth.measured[8:-8, 8:-8].mean() > 0.97
    error = np.abs(depth.depth_mm - compute_depth_mm(rig, solids))[8:-8, 8:-8]
    assert np.nanmedian(error) < (0.6 if preset == "fast" else 0.2)


def test_progress_ends_at_its_total(run):
    _, steps = run
    assert steps == [("matching 000", i, len(steps)) for i in range(1, len(steps) + 1)]
