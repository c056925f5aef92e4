"""Uncertain pixels beside steps take the right candidate surface; reliable pixels stay as they are."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.kernels import load
from beltscape.learned.registry import load_network
from beltscape.stereo.multiview.candidates import (
    PIXEL_FEATURES,
    RELIABLE,
    UNCERTAIN,
    CandidateSelector,
    Selection,
    begin_selection,
    finish_selection,
)
from beltscape.stereo.multiview.features import compute_image_features, compute_initial_confidence_features
from beltscape.stereo.multiview.surface import Surface, detect_depth_steps, fit_slopes
from tests.stereo.scenes import Scene, make_scene, mask_inner, patch, plane, with_context, with_scale

STEP = (plane(760), patch(640, (-90, 90), (-130, 130)))
FAR_OFF_PX = 12.0


def select_candidates(surface, planes, prepared) -> Selection:
    """Return what a match selects."""
    return finish_selection(*begin_selection(surface, planes, prepared))


def beside_steps(made: Scene) -> np.ndarray:
    """Return the mask (H, W) of pixels next to depth steps."""
    return detect_depth_steps(made.s) & mask_inner(made.s.shape, 6)


def displaced(made: Scene, share: float = 0.5) -> tuple[Surface, np.ndarray]:
    """Return the true surface with a share of the pixels beside its steps displaced, and their mask."""
    rng = np.random.default_rng(3)
    wrong = beside_steps(made) & (rng.random(made.s.shape) < share)
    s = np.where(wrong, made.s + FAR_OFF_PX, made.s).astype(np.float32)
    slopes = fit_slopes(made.s, load(), 1)
    return Surface(s, slopes.slope_u, slopes.slope_v), wrong


def planes_of(made: Scene, confidence: np.ndarray) -> dict[str, np.ndarray]:
    """Return `PIXEL_FEATURES` of an average surface."""
    none = np.zeros(made.s.shape, np.float32)
    given = dict.fromkeys(PIXEL_FEATURES, none) | {
        "cost": none + 0.02,
        "log sigma": none - 3,
        "margin": none + 0.05,
    }
    prepared = with_scale(made.prepared)
    initial = dict(compute_initial_confidence_features(confidence, prepared.context.windows))
    return given | compute_image_features(prepared).planes | initial


def selected_surface(made: Scene, surface: Surface) -> tuple[Selection, np.ndarray]:
    uncertain = beside_steps(made)
    confidence = np.where(uncertain, -0.5, 6.0).astype(np.float32)
    return select_candidates(surface, planes_of(made, confidence), with_scale(made.prepared)), uncertain


def test_most_displaced_pixels_take_the_right_surface():
    made = make_scene(*STEP, noise=1.0)
    surface, wrong = displaced(made)
    selection, _ = selected_surface(made, surface)
    off = np.abs(selection.surface.s - made.s)
    assert wrong.sum() > 100
    assert (off[wrong] < 1).mean() > 0.75
    right = beside_steps(made) & ~wrong
    assert (off[right] < 1).mean() > 0.9


def test_the_initial_confidence_separates_right_from_wrong_selections():
    made = make_scene(*STEP, noise=1.0)
    selection, uncertain = selected_surface(made, displaced(made)[0])
    right = np.abs(selection.surface.s - made.s)[uncertain] < 1
    score = selection.initial_confidence[uncertain]
    assert (score[right][:, None] > score[~right]).mean() > 0.75


def test_only_uncertain_pixels_within_reach_of_reliable_ones_change():
    made = make_scene(*STEP, noise=1.0)
    surface, _ = displaced(made)
    selection, uncertain = selected_surface(made, surface)
    for field in ("s", "slope_u", "slope_v"):
        before, after = getattr(surface, field), getattr(selection.surface, field)
        assert before[~uncertain].tobytes() == after[~uncertain].tobytes()
    none_reliable = np.full(made.s.shape, RELIABLE - 1, np.float32)
    left = select_candidates(surface, planes_of(made, none_reliable), with_scale(made.prepared))
    assert left.surface.s.tobytes() == surface.s.tobytes()
    all_certain = np.full(made.s.shape, UNCERTAIN + 1, np.float32)
    left = select_candidates(surface, planes_of(made, all_certain), with_scale(made.prepared))
    assert left.surface.s.tobytes() == surface.s.tobytes()


def test_a_pixel_without_a_surface_gets_one():
    made = make_scene(plane(), noise=1.0)
    hole = np.zeros(made.s.shape, bool)
    hole[50:54, 60:64] = True
    slopes = fit_slopes(made.s, load(), 1)
    surface = Surface(np.where(hole, np.nan, made.s).astype(np.float32), slopes.slope_u, slopes.slope_v)
    confidence = np.where(hole, -5.0, 6.0).astype(np.float32)
    selection = select_candidates(surface, planes_of(made, confidence), with_scale(made.prepared))
    np.testing.assert_allclose(selection.surface.s[hole], made.s[hole], atol=0.1)


@pytest.mark.parametrize("threads", [2, 3])
def test_selection_does_not_depend_on_the_number_of_threads(threads):
    made = make_scene(*STEP, noise=1.0)
    surface, _ = displaced(made)
    confidence = np.where(beside_steps(made), -0.5, 6.0).astype(np.float32)
    planes = planes_of(made, confidence)
    one, many = (
        select_candidates(surface, planes, with_context(with_scale(made.prepared), threads=n))
        for n in (1, threads)
    )
    assert one.surface.s.tobytes() == many.surface.s.tobytes()
    assert one.initial_confidence.tobytes() == many.initial_confidence.tobytes()


def test_the_features_of_candidates_are_finite():
    made = make_scene(*STEP, noise=1.0)
    surface, _ = displaced(made)
    confidence = np.where(beside_steps(made), -0.5, 6.0).astype(np.float32)
    selector = CandidateSelector.from_surface(surface, planes_of(made, confidence), with_scale(made.prepared))
    assert selector.find_uncertain_pixels()
    for at in selector.find_uncertain_pixels():
        candidates, features = selector.find_candidates(at)
        finite = np.isfinite(candidates.s)
        assert finite[0].all()
        for name, values in features.items():
            assert values.shape == (1, finite.sum()), name
            assert np.isfinite(values).all(), name


def test_pixels_without_any_candidate_keep_their_confidence():
    made = make_scene(plane(), noise=1.0)
    slopes = fit_slopes(made.s, load(), 1)
    # no column, row or diagonal of the pixel meets the reliable one
    s, confidence = np.full_like(made.s, np.nan), np.full(made.s.shape, UNCERTAIN + 1, np.float32)
    s[50, 60], confidence[50, 60], confidence[52, 63] = made.s[50, 60], RELIABLE, -1.0
    confidence[confidence > UNCERTAIN] = RELIABLE - 0.5
    surface = Surface(s, slopes.slope_u, slopes.slope_v)
    selection = select_candidates(surface, planes_of(made, confidence), with_scale(made.prepared))
    assert selection.initial_confidence[52, 63] == -1.0
    assert np.isnan(selection.surface.s[52, 63])


def test_the_most_probable_candidate_is_selected():
    made = make_scene(*STEP, noise=1.0)
    surface, _ = displaced(made)
    confidence = np.where(beside_steps(made), -0.5, 6.0).astype(np.float32)
    selector = CandidateSelector.from_surface(surface, planes_of(made, confidence), with_scale(made.prepared))
    candidates, features = selector.find_candidates(selector.find_uncertain_pixels()[0])
    selected, logit = selector.select(candidates, features)
    logits = np.full(candidates.s.shape, -np.inf, np.float32)
    logits[np.isfinite(candidates.s)] = load_network("candidates").evaluate(features, load(), 1)[0][0]
    pixel = np.arange(len(selected))
    assert np.isfinite(candidates.s[selected, pixel]).all()
    assert len(set(selected)) > 1
    np.testing.assert_array_equal(logit, logits[selected, pixel])
    np.testing.assert_array_equal(logit, logits.max(axis=0))
