"""Doubtful pixels beside steps take the right one of their neighbours' surfaces; what is trusted stays."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import Scene, inner, patch, plane, scene

from beltscape.kernels import load
from beltscape.stereo.multiview.confidence.features import image_features
from beltscape.stereo.multiview.confidence.refined_features import initial_confidence_features
from beltscape.stereo.multiview.frame.surface import Surface, detect_depth_steps, fit_slopes
from beltscape.stereo.multiview.networks import load_network
from beltscape.stereo.multiview.selection.candidates import (
    PIXEL_FEATURES,
    RELIABLE,
    SAME_PX,
    UNCERTAIN,
    CandidateSelector,
    Selection,
    select_candidates,
)

STEP = (plane(760), patch(640, (-90, 90), (-130, 130)))
FAR_OFF_PX = 12.0


def beside_steps(made: Scene) -> np.ndarray:
    """(H, W) pixels whose surface is anybody's guess."""
    return detect_depth_steps(made.s) & inner(made.s.shape, 6)


def confused(made: Scene, share: float = 0.5) -> tuple[Surface, np.ndarray]:
    """The true surface, a share of the pixels beside its steps far off, and which are."""
    rng = np.random.default_rng(3)
    wrong = beside_steps(made) & (rng.random(made.s.shape) < share)
    s = np.where(wrong, made.s + FAR_OFF_PX, made.s).astype(np.float32)
    slopes = fit_slopes(made.s, load(), 1)
    return Surface(s, slopes.slope_u, slopes.slope_v), wrong


def planes_of(made: Scene, impression: np.ndarray) -> dict[str, np.ndarray]:
    """What `PIXEL_FEATURES` names, of a surface that fits nowhere in particular."""
    none = np.zeros(made.s.shape, np.float32)
    given = dict.fromkeys(PIXEL_FEATURES, none) | {
        "cost": none + 0.02,
        "log sigma": none - 3,
        "margin": none + 0.05,
    }
    return (
        given | dict(image_features(made.prepared, 1.0)) | dict(initial_confidence_features(impression, 1.0))
    )


def held(made: Scene, surface: Surface) -> tuple[Selection, np.ndarray]:
    doubt = beside_steps(made)
    impression = np.where(doubt, -0.5, 6.0).astype(np.float32)
    return select_candidates(surface, planes_of(made, impression), made.prepared, 1.0, load(), 1), doubt


def test_most_pixels_that_were_far_off_find_their_surface():
    made = scene(*STEP, noise=1.0)
    surface, wrong = confused(made)
    won, _ = held(made, surface)
    off = np.abs(won.surface.s - made.s)
    assert wrong.sum() > 100
    assert (off[wrong] < 1).mean() > 0.75
    right = beside_steps(made) & ~wrong
    assert (off[right] < 1).mean() > 0.9


def test_the_impression_tells_right_from_wrong_winners():
    made = scene(*STEP, noise=1.0)
    won, doubt = held(made, confused(made)[0])
    right = np.abs(won.surface.s - made.s)[doubt] < 1
    score = won.impression[doubt]
    assert score[right].mean() > score[~right].mean() + 1


def test_only_doubtful_pixels_within_reach_of_trusted_ones_change():
    made = scene(*STEP, noise=1.0)
    surface, _ = confused(made)
    won, doubt = held(made, surface)
    for field in ("s", "slope_u", "slope_v"):
        before, after = getattr(surface, field), getattr(won.surface, field)
        assert before[~doubt].tobytes() == after[~doubt].tobytes()
    nobody = np.full(made.s.shape, RELIABLE - 1, np.float32)
    left = select_candidates(surface, planes_of(made, nobody), made.prepared, 1.0, load(), 1)
    assert left.surface.s.tobytes() == surface.s.tobytes()
    everybody = np.full(made.s.shape, UNCERTAIN + 1, np.float32)
    left = select_candidates(surface, planes_of(made, everybody), made.prepared, 1.0, load(), 1)
    assert left.surface.s.tobytes() == surface.s.tobytes()


def test_a_pixel_without_a_surface_gets_one():
    made = scene(plane(), noise=1.0)
    hole = np.zeros(made.s.shape, bool)
    hole[50:54, 60:64] = True
    slopes = fit_slopes(made.s, load(), 1)
    surface = Surface(np.where(hole, np.nan, made.s).astype(np.float32), slopes.slope_u, slopes.slope_v)
    impression = np.where(hole, -5.0, 6.0).astype(np.float32)
    won = select_candidates(surface, planes_of(made, impression), made.prepared, 1.0, load(), 1)
    np.testing.assert_allclose(won.surface.s[hole], made.s[hole], atol=0.1)


@pytest.mark.parametrize("threads", [2, 3])
def test_any_number_of_threads_gives_the_same_bytes(threads):
    made = scene(*STEP, noise=1.0)
    surface, _ = confused(made)
    impression = np.where(beside_steps(made), -0.5, 6.0).astype(np.float32)
    planes = planes_of(made, impression)
    one, many = (select_candidates(surface, planes, made.prepared, 1.0, load(), n) for n in (1, threads))
    assert one.surface.s.tobytes() == many.surface.s.tobytes()
    assert one.impression.tobytes() == many.impression.tobytes()


def test_rivals_are_told_apart_by_finite_evidence():
    made = scene(*STEP, noise=1.0)
    surface, _ = confused(made)
    impression = np.where(beside_steps(made), -0.5, 6.0).astype(np.float32)
    arena = CandidateSelector.of(surface, planes_of(made, impression), made.prepared, 1.0, load(), 1)
    assert arena.doubtful()
    for at in arena.doubtful():
        rivals, evidence = arena.look(at)
        known = np.isfinite(rivals.s)
        assert known[0].all()
        for name, plane_ in evidence.items():
            assert plane_.shape == known.shape, name
            assert np.isfinite(plane_[known]).all(), name


def test_finalists_say_something_else_and_their_duel_is_all_that_is_weighed():
    made = scene(*STEP, noise=1.0)
    surface, _ = confused(made)
    impression = np.where(beside_steps(made), -0.5, 6.0).astype(np.float32)
    arena = CandidateSelector.of(surface, planes_of(made, impression), made.prepared, 1.0, load(), 1)
    at = arena.doubtful()[0]
    rivals, evidence = arena.look(at)
    first, second, score = arena.finalists(rivals, evidence)
    pixel, met = np.arange(len(first)), np.flatnonzero(second >= 0)
    assert len(met) > 0
    assert (score[first, pixel] == score.max(axis=0)).all()
    assert (np.abs(rivals.s[first, pixel] - rivals.s[second, pixel])[met] > SAME_PX).all()
    assert (score[second, pixel][met] <= score[first, pixel][met]).all()
    both = arena.duel(at, rivals, {**evidence, "score": score}, met, (first[met], second[met]))
    assert set(both) == set(load_network("duel").names)
    for name, values in both.items():
        assert values.shape == (1, len(met)), name
        assert np.isfinite(values).all(), name
    np.testing.assert_array_equal(both["second score"][0], score[second[met], met])


def test_who_has_no_opponent_wins():
    made = scene(plane(), noise=1.0)
    slopes = fit_slopes(made.s, load(), 1)
    surface = Surface(made.s, slopes.slope_u, slopes.slope_v)
    impression = np.where(np.random.default_rng(2).random(made.s.shape) < 0.1, -0.5, 6.0).astype(np.float32)
    arena = CandidateSelector.of(surface, planes_of(made, impression), made.prepared, 1.0, load(), 1)
    at = arena.doubtful()[0]
    rivals, evidence = arena.look(at)
    first, second, score = arena.finalists(rivals, evidence)
    assert (second == -1).all()
    winner, logit = arena.winners(at, rivals, evidence)
    np.testing.assert_array_equal(winner, first)
    np.testing.assert_array_equal(logit, score.max(axis=0))
