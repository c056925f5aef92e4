"""What is believed of a surface: not what no auxiliary sees, and false surfaces less than right ones."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scenes import away_from_steps, cast, depth_mm, inner, patch, plane, ring, scene, sphere

from beltscape.kernels import load
from beltscape.stereo.multiview.confidence.estimate import (
    DepthEstimate,
    estimate_depth,
    initial_features,
    refined_features,
    with_initial_confidence,
)
from beltscape.stereo.multiview.confidence.features import agreement_features, image_features, shape_features
from beltscape.stereo.multiview.frame.surface import fit_slopes
from beltscape.stereo.multiview.frame.windows import windows_for
from beltscape.stereo.multiview.networks import load_network
from beltscape.stereo.multiview.optimisation.least_squares import refine
from beltscape.stereo.multiview.optimisation.propagation import propagate
from beltscape.stereo.multiview.selection.candidates import CandidateSelector, Selection
from beltscape.stereo.multiview.settings import MultiviewSettings
from beltscape.stereo.multiview.state import MatcherState

STEP = (plane(820), patch(560, (-90, 90), (-130, 130)))


def stages(made, s: np.ndarray) -> MatcherState:
    """One propagation and refinement, as the matcher's last round."""
    size, prepared = windows_for(s.shape[1]), made.prepared
    chosen = propagate(fit_slopes(s.astype(np.float32), load(), 1), prepared, (2, 5), load(), 1)
    refined = refine(chosen.surface, prepared, (0.7, 0.4), size.wide, size.levels_px, load(), 1)
    light, none = dict(image_features(prepared, size.scale)), np.zeros(s.shape, bool)
    return MatcherState(prepared, chosen, refined, light, none, None)


def looked_at_again(match: MatcherState) -> MatcherState:
    """With the impression of a first look."""
    scale = windows_for(match.prepared.core.shape[1]).scale
    planes = with_initial_confidence(initial_features(match, scale, load(), 1), scale, load(), 1)
    arena = CandidateSelector.of(match.refined.surface, planes, match.prepared, scale, load(), 1)
    contested = Selection(match.refined.surface, planes["impression"], arena.likeness.brightness)
    return replace(match, contested=contested)


LOOKS = pytest.mark.parametrize("again", [False, True], ids=["at a glance", "looked at again"])


def verdict(made, s: np.ndarray, again: bool) -> tuple[DepthEstimate, np.ndarray]:
    """And the surface that was judged."""
    match = stages(made, s)
    if again:
        match = looked_at_again(match)
    return estimate_depth(match, windows_for(s.shape[1]).scale, load(), 1), match.refined.surface.s


def surface_planes(match: MatcherState, scale: float) -> dict[str, np.ndarray]:
    """Where every auxiliary sees everything."""
    seen = np.ones(match.prepared.core.shape, np.uint8)
    agreement = agreement_features(match.chosen, match.refined, 4, seen, scale)
    return dict(agreement) | dict(shape_features(match.chosen, match.refined, scale))


def views_by_rays(made, solids) -> np.ndarray:
    """(H, W) how many auxiliaries see the true surface, by casting rays back to it."""
    rig = made.rig
    z = depth_mm(rig, solids)[..., None]
    points = np.concatenate([rig.core_camera.rays() * z, z], axis=-1)
    seen = np.zeros(z.shape[:2], np.uint8)
    for name in rig.auxiliaries:
        cam, pose = rig.cameras[name], rig.cam_from_core[name]
        at = pose.apply(points.reshape(-1, 3)).reshape(points.shape)
        hit = cast(cam, pose, solids, at[..., :2] / at[..., 2:])
        pixels = cam.project(at.reshape(-1, 3)).reshape(*at.shape[:2], 2)
        inside = ((pixels >= 0) & (pixels <= np.array(cam.size_px) - 1)).all(axis=-1)
        seen += (inside & (np.abs(hit - points).max(axis=-1) < 1)).astype(np.uint8)
    return seen


@LOOKS
def test_every_weight_is_of_some_evidence(again):
    match = looked_at_again(stages(made := scene(*STEP, noise=1.0), made.s))
    scale = windows_for(made.s.shape[1]).scale
    assert match.contested is not None
    if again:
        found = refined_features(match, match.contested, scale, load(), 1)[0].planes
        assert set(load_network("belief").names) <= found.keys()
    else:
        found = initial_features(match, scale, load(), 1).planes
        assert {*load_network("impression").names, *load_network("glance").names} <= found.keys()
    for name, value in found.items():
        assert np.isfinite(value).all(), name
        assert value.shape == made.s.shape


@pytest.mark.parametrize(
    ("name", "answers"),
    [("impression", 1), ("rivals", 1), ("belief", 2), ("glance", 2), ("scrutiny", 48), ("duel", 2)],
)
def test_the_weights_that_ship_fit_each_other(name, answers):
    belief = load_network(name)
    n = len(belief.names)
    assert len(set(belief.names)) == n
    assert (belief.limits[0] <= belief.limits[1]).all()
    assert belief.limits.shape == (2, n)
    for layer in belief.layers:
        assert layer.shape[1] == n + 1
        n = len(layer)
    assert n == answers


def test_relief_and_light_are_what_their_names_say():
    made = scene(*STEP, noise=1.0)
    shaded = made.prepared.core.copy()
    shaded[40:70, 50:80] *= 0.3
    prepared = replace(made.prepared, core=shaded)
    match = stages(made, made.s)
    found = dict(image_features(prepared, 1.0)) | surface_planes(match, 1.0)
    shadow, rest = (slice(48, 62), slice(58, 72)), (slice(90, 110), slice(50, 80))
    assert np.median(found["light within 11"][shadow]) < np.median(found["light within 11"][rest]) - 0.1
    assert np.median(found["contrast within 11"][shadow]) < np.median(found["contrast within 11"][rest]) - 0.5
    for side in (5, 11, 21):
        s = match.refined.surface.s
        nearer, farther = found[f"nearer within {side}"], found[f"farther within {side}"]
        window = np.ones((side, side), np.uint8)
        span = cv2.dilate(s, window) - cv2.erode(s, window)
        np.testing.assert_allclose((nearer + farther)[span < 30], span[span < 30], atol=1e-3)


def test_steps_and_distances_are_told_in_pixels_of_a_grid_of_scale_one():
    made = scene(*STEP, noise=1.0)
    one, two = (surface_planes(stages(made, made.s), scale) for scale in (1.0, 2.0))
    for name in ("at a step", "near a step"):
        np.testing.assert_allclose(two[name] ** 2, one[name], atol=1e-6)
    off = one["off its neighbours"]
    assert (off > 0).any()
    np.testing.assert_allclose(two["off its neighbours"][off < 1], off[off < 1] / 2, atol=1e-6)


def test_planes_turn_less_than_round_flanks_and_what_was_left_alone_has_not_moved():
    flat, round_ = scene(plane(), noise=1.0), scene(sphere(660, 60), plane(800), noise=1.0)
    found = []
    for made in (flat, round_):
        match = stages(made, made.s)
        still = replace(match, chosen=replace(match.chosen, surface=match.refined.surface))
        moved, left = (surface_planes(one, 1.0) for one in (match, still))
        assert (left["moved"] <= moved["moved"] + 1e-5).all()
        assert np.ptp(left["moved"]) < 1e-5
        found.append(moved)
    height, width = flat.s.shape
    flank = slice(height // 2 - 3, height // 2 + 4), slice(width // 2 + 8, width // 2 + 15)
    for name in ("turn", "wide turn"):
        assert np.median(found[1][name][flank]) > np.median(found[0][name][flank]) + 0.5


@LOOKS
@pytest.mark.parametrize("angles", [(0,), (0, 30), (0, 90, 180, 270)])
def test_what_is_hidden_from_all_auxiliaries_is_not_believed(angles, again):
    made = scene(*STEP, rig=ring(angles), noise=1.0)
    judged, _ = verdict(made, made.s, again)
    truth = views_by_rays(made, STEP)
    clear = cv2.erode(truth, np.ones((7, 7))) == cv2.dilate(truth, np.ones((7, 7)))
    hidden, seen = clear & (truth == 0), clear & (truth > 0) & inner(truth.shape, 8)
    if len(angles) < 4:
        assert hidden.sum() > 100
        assert not judged.confidence[hidden].any()
        assert not judged.views[hidden].any()
    assert (judged.confidence[seen] > 0.5).mean() > 0.95
    assert (judged.views[seen] == truth[seen]).mean() > 0.95
    assert judged.views.max() <= len(angles)


@LOOKS
def test_false_surfaces_are_believed_less_than_right_ones(again):
    made = scene(plane(), noise=1.0)
    wrong = inner(made.s.shape, 30)
    judged, s = verdict(made, np.where(wrong, made.s + 5, made.s), again)
    error = np.abs(s - made.s)
    false, right = error > 1, (error < 0.1) & inner(s.shape, 8)
    assert false.sum() > 0.5 * wrong.sum()
    ranks = np.searchsorted(np.sort(judged.confidence[right]), judged.confidence[false]) / right.sum()
    assert ranks.mean() < 0.1  # the chance that a false pixel is believed more than a right one
    assert (judged.confidence[false] < MultiviewSettings().least_confidence).mean() > 0.9
    assert (judged.confidence[right] > 0.9).mean() > 0.9


@LOOKS
def test_confidence_and_sigma_are_what_they_say_they_are(again):
    made = scene(*STEP, noise=3.0)
    s = made.s.copy()
    s[30:50, 20:40] = np.nan
    judged, left = verdict(made, s, again)
    assert judged.confidence.dtype == judged.sigma.dtype == np.float32
    assert ((judged.confidence >= 0) & (judged.confidence <= 1)).all()
    assert not judged.confidence[np.isnan(left)].any()
    assert (judged.sigma[judged.confidence > 0] > 0).all()


@LOOKS
def test_even_shading_is_not_believed_but_a_discs_rim_is(again):
    made = scene(plane(), noise=1.0)
    match = stages(made, made.s)
    match = looked_at_again(match) if again else match
    core = made.prepared.core.copy()
    v, u = np.mgrid[: core.shape[0], : core.shape[1]].astype(np.float32)
    shaded = u >= 60
    core[shaded] = (40 + 0.9 * u + 0.5 * v + np.random.default_rng(1).normal(0, 1, core.shape))[shaded]
    disc = (u - 90) ** 2 + (v - 50) ** 2 < 8**2
    blind = replace(match, prepared=replace(made.prepared, core=core))
    inside = shaded & (u > 60 + 12) & inner(core.shape, 6)
    assert (estimate_depth(match, 1.0, load(), 1).confidence[inside] > 0.5).mean() > 0.9
    assert (estimate_depth(blind, 1.0, load(), 1).confidence[inside] == 0).all()
    kept = estimate_depth(replace(blind, continued=disc), 1.0, load(), 1).confidence
    assert (kept[inside & ~disc] == 0).all()
    assert (kept[disc] > 0).all()


@LOOKS
def test_sigma_is_larger_on_round_flanks_than_on_a_plane(again):
    flat, round_ = scene(plane(), noise=1.0), scene(sphere(660, 60), plane(800), noise=1.0)
    height, width = flat.s.shape
    flank = slice(height // 2 - 3, height // 2 + 4), slice(width // 2 + 8, width // 2 + 15)
    on_plane, on_flank = (np.median(verdict(made, made.s, again)[0].sigma[flank]) for made in (flat, round_))
    assert on_flank > 1.3 * on_plane


@LOOKS
def test_sigma_grows_with_the_noise(again):
    def median_sigma(noise):
        made = scene(plane(), noise=noise)
        return np.median(verdict(made, made.s, again)[0].sigma[away_from_steps(made.s, 8)])

    assert median_sigma(8.0) > 1.5 * median_sigma(2.0)
