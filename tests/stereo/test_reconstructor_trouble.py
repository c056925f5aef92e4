"""The multi-view matcher on missing, dark, blurred, masked or empty images: fewer pixels, no gross errors."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.evaluate.depth_scores import GROSS_MM, score_depth
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.settings import MultiviewSettings
from tests.stereo.raycast import compute_true_depth, make_world_rig, render_frame
from tests.thorough import list_cases

AUXILIARIES = ("cam1", "cam2", "cam3", "cam4")
STRIP = slice(150, 230)
WELL_INSIDE = slice(160, 220)


@pytest.fixture(scope="module")
def belt():
    rig, core_from_world = make_world_rig()
    return rig, render_frame(rig, core_from_world), compute_true_depth(rig, core_from_world)


@pytest.fixture(scope="module")
def matcher(belt):
    return MultiviewReconstructor(belt[0], (600, 780), MultiviewSettings(threads=1))


@pytest.fixture(scope="module")
def measured(belt, matcher):
    return matcher.reconstruct(belt[1], Silent())


def change_images(frames: FrameSet, change, *names: str) -> FrameSet:
    """Return the frame with the images of these cameras changed, or of all cameras."""
    return FrameSet(
        frames.frame,
        {n: change(i) if not names or n in names else i for n, i in frames.images.items()},
    )


def remove_cameras(frames: FrameSet, *names: str) -> FrameSet:
    return FrameSet(frames.frame, {n: i for n, i in frames.images.items() if n not in names})


def compute_gross_share(depth: DepthMap, truth: np.ndarray) -> float:
    """Return the share of all pixels that are measured and wrong by more than 5 mm."""
    return float((np.abs(depth.depth_mm - truth) > GROSS_MM).mean())


def darken(image):
    return np.rint(image * 0.8).astype(image.dtype)


def defocus(image):
    return cv2.GaussianBlur(image, (0, 0), 1.6)


def blacken(image):
    return np.zeros_like(image)


def black_out_strip(image):
    image = image.copy()
    image[:, STRIP] = 0
    return image


def flip(image):
    return image[::-1].copy()


@pytest.mark.parametrize("change", list_cases([darken, defocus, blacken, flip], [defocus, flip]))
def test_one_bad_auxiliary_among_four_hardly_reduces_accuracy(belt, matcher, change):
    _, frames, truth = belt
    score = score_depth(matcher.reconstruct(change_images(frames, change, "cam2"), Silent()), truth)
    assert score.within_1mm > 0.985
    assert score.interior_median_mm < 0.07
    assert abs(score.interior_bias_mm) < 0.02
    assert score.gross < 0.002
    assert 0.6 < score.sigma_ratio < 1.6


def test_darker_core_does_not_reduce_accuracy(belt, matcher):
    _, frames, truth = belt
    score = score_depth(matcher.reconstruct(change_images(frames, darken, "cam0"), Silent()), truth)
    assert score.within_1mm > 0.99
    assert score.interior_median_mm < 0.06


def test_more_noise_raises_sigma_without_gross_errors(belt, matcher, measured):
    rig, _, truth = belt
    noisy = matcher.reconstruct(render_frame(rig, make_world_rig()[1], noise_counts=6.0), Silent())
    score = score_depth(noisy, truth)
    assert score.within_1mm > 0.98
    assert score.gross < 0.003
    assert 0.6 < score.sigma_ratio < 1.6
    assert np.nanmedian(noisy.sigma_mm) > 1.5 * np.nanmedian(measured.sigma_mm)


def test_missing_auxiliary_is_left_out(belt, matcher):
    _, frames, truth = belt
    depth = matcher.reconstruct(remove_cameras(frames, "cam2"), Silent())
    assert depth.views.max() == 3
    assert score_depth(depth, truth).within_1mm > 0.99
    assert matcher.reconstruct(frames, Silent()).views.max() == 4


@pytest.mark.parametrize(
    ("missing", "message"),
    [
        (("cam0",), "frame 000: no usable image of the core camera cam0; depth is measured in its view"),
        (
            AUXILIARIES,
            r"frame 000: no usable image of an auxiliary camera \(cam1, cam2, cam3, cam4\); depth needs a second",
        ),
    ],
)
def test_error_names_the_missing_images(belt, matcher, missing, message):
    with pytest.raises(ReconstructionError, match=message):
        matcher.reconstruct(remove_cameras(belt[1], *missing), Silent())


def test_error_names_an_unknown_auxiliary(belt):
    with pytest.raises(ReconstructionError, match="cam9 is no auxiliary camera of the rig; there are cam1"):
        MultiviewReconstructor(belt[0], (600, 780), MultiviewSettings(), auxiliaries=("cam9",))


@pytest.mark.parametrize("names", list_cases([(), ("cam0",)], [()]))
def test_black_strip_is_not_measured(belt, matcher, names):
    _, frames, truth = belt
    depth = matcher.reconstruct(change_images(frames, black_out_strip, *names), Silent())
    assert depth.measured[:, WELL_INSIDE].mean() < 0.05
    assert compute_gross_share(depth, truth) < 0.01
    beside = np.ones(truth.shape, bool)
    beside[:, STRIP.start - 8 : STRIP.stop + 8] = False
    assert score_depth(depth, truth, beside).within_1mm > 0.8


EMPTY = {
    "black": lambda _, shape: np.zeros(shape),
    "even": lambda _, shape: np.full(shape, 90.0),
    "noise": lambda rng, shape: 90 + rng.normal(0, 2, shape),
    "dark noise": lambda rng, shape: rng.normal(1, 1, shape),
    "a gradient": lambda rng, shape: np.linspace(50, 120, shape[1]) + rng.normal(0, 1, shape),
}


@pytest.mark.parametrize("kind", list_cases(EMPTY, ("dark noise", "a gradient")))
def test_images_without_texture_are_hardly_measured(belt, matcher, kind):
    rng = np.random.default_rng(8)
    images = {
        name: np.clip(np.rint(EMPTY[kind](rng, image.shape)), 0, 255).astype(np.uint8)
        for name, image in belt[1].images.items()
    }
    assert matcher.reconstruct(FrameSet("000", images), Silent()).coverage < 0.02


def test_images_of_different_scenes_are_not_matched(belt, matcher):
    _, frames, truth = belt
    depth = matcher.reconstruct(change_images(frames, lambda i: i[::-1, ::-1].copy(), *AUXILIARIES), Silent())
    assert compute_gross_share(depth, truth) < 0.05
