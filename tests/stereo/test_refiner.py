"""Refinement changes uncertain pixels only: their s, confidence and sigma."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import beltscape
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.files.images import read_image
from beltscape.files.rig_json import read_rig
from beltscape.files.tiff import read_float_tiff
from beltscape.kernels import load
from beltscape.learned.registry import load_network
from beltscape.stereo.multiview.estimate import MOST_PX, Prediction, mask_uncertain, refine_uncertain_pixels
from beltscape.stereo.multiview.features import ConfidenceInputs, MatcherState, compute_initial_features
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.multiview.refined_features import TRIED_PX, RefinementInputs
from beltscape.stereo.settings import MultiviewSettings
from tests.stereo.scenes import Scene, make_scene, mask_away_from_steps, mask_inner, with_context, with_scale
from tests.stereo.test_estimate import STEP, run_stages, with_selection


def predict(state: MatcherState) -> tuple[RefinementInputs, Prediction]:
    """Return the inputs of the refinement, and the prediction before it."""
    assert state.selection is not None
    surface = ConfidenceInputs.from_state(state)
    inputs = RefinementInputs.from_selection(surface, compute_initial_features(surface), state.selection)
    outputs = load_network("confidence").evaluate(inputs.planes, load(), 1)
    return inputs, Prediction(state.solution.surface.s, *outputs)


def full_scale(made: Scene, s: np.ndarray) -> MatcherState:
    state = with_selection(run_stages(made, s))
    return replace(state, prepared=with_scale(state.prepared))


def with_threads(inputs: RefinementInputs, threads: int) -> RefinementInputs:
    consistency = inputs.consistency
    prepared = with_context(consistency.prepared, threads=threads)
    return replace(inputs, consistency=replace(consistency, prepared=prepared))


@pytest.fixture(scope="module")
def predicted() -> tuple[RefinementInputs, Prediction, np.ndarray]:
    """Return inputs and prediction of a step, of which a tenth is displaced, and the true s."""
    made = make_scene(*STEP, noise=1.0)
    rng = np.random.default_rng(4)
    wrong = rng.random(made.s.shape) < 0.1
    return *predict(full_scale(made, np.where(wrong, made.s + 6, made.s))), made.s


def test_computed_features_are_those_of_the_network(predicted):
    inputs, prediction, _ = predicted
    at = np.nonzero(mask_uncertain(prediction.logit))
    shown = inputs.compute_features(at, prediction.logit[at])
    assert set(load_network("refinement").features) == set(shown)
    for name, values in shown.items():
        assert np.isfinite(values).all(), name


def test_only_uncertain_pixels_change(predicted):
    inputs, prediction, _ = predicted
    found = refine_uncertain_pixels(prediction, inputs)
    uncertain = mask_uncertain(prediction.logit)
    assert uncertain.any()
    assert (prediction.logit[~uncertain] < 0).any()
    assert (prediction.logit[~uncertain] > 0).any()
    for new, old in zip(found, prediction, strict=True):
        assert new[~uncertain].tobytes() == old[~uncertain].tobytes()
        assert (new[uncertain] != old[uncertain]).mean() > 0.99
    assert np.abs(found.s - prediction.s).max() <= MOST_PX + 1e-3


def test_right_pixels_have_more_confidence_than_wrong_ones(predicted):
    inputs, prediction, true = predicted
    found = refine_uncertain_pixels(prediction, inputs)
    uncertain = mask_uncertain(prediction.logit) & mask_inner(true.shape, 6)
    off = np.abs(found.s - true)
    right, wrong = found.logit[uncertain & (off < 0.5)], found.logit[uncertain & (off > 3)]
    assert len(wrong) >= 15
    assert np.median(right) > np.median(wrong) + 2


def test_refinement_reduces_errors_of_the_demo():
    data = Path(beltscape.__file__).parent / "data" / "demo"
    rig, true_mm = (
        read_rig(data / "truth" / "rig.json"),
        read_float_tiff(data / "truth" / "belt_loaded_depth.tiff"),
    )
    images = {name: read_image(data / "belt_loaded" / name / "000.png") for name in rig.cameras}
    matcher = MultiviewReconstructor(rig, (520, 800), MultiviewSettings())
    inputs, prediction = predict(matcher.match(FrameSet("000", images), rig.auxiliaries, Silent()))
    s = refine_uncertain_pixels(prediction, inputs).s
    true = 1 / (true_mm * inputs.context.inverse_depth_scale)
    uncertain = mask_uncertain(prediction.logit) & (prediction.logit > 0) & np.isfinite(true)
    before, after = (np.abs(x - true)[uncertain] for x in (prediction.s, s))
    assert uncertain.sum() > 5000
    for least, gain in ((0.1, 0.005), (0.3, 0.01), (0.7, 0.005)):
        assert (after < least).mean() > (before < least).mean() + gain, least


def test_photo_consistency_falls_off_the_surface(predicted):
    inputs, _, true = predicted
    right = (
        (np.abs(inputs.surface.s - true) < 0.1) & mask_away_from_steps(true, 4) & mask_inner(true.shape, 8)
    )
    at = np.nonzero(right)
    shown = inputs.compute_features(at, np.zeros(len(at[0]), np.float32))
    for name in ("point mean", "cross mean"):
        here = np.median(inputs.planes[name][at])
        off = [np.median(shown[f"{name} {px:+g}"]) for px in TRIED_PX]
        assert off[0] > off[2] > here < off[3] < off[5]


@pytest.mark.parametrize("threads", [2, 3])
def test_refinement_does_not_depend_on_the_number_of_threads(predicted, threads):
    inputs, prediction, _ = predicted
    for many, one in zip(
        refine_uncertain_pixels(prediction, with_threads(inputs, threads)),
        refine_uncertain_pixels(prediction, inputs),
        strict=True,
    ):
        assert many.tobytes() == one.tobytes()


def test_without_uncertain_pixels_nothing_changes(predicted):
    inputs, prediction, _ = predicted
    accepted = prediction._replace(logit=np.full_like(prediction.logit, 9.0))
    for new, old in zip(refine_uncertain_pixels(accepted, inputs), accepted, strict=True):
        assert new.tobytes() == old.tobytes()
