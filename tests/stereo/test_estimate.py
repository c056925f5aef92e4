"""The depth estimate: no confidence without a view, low confidence of false surfaces, and sigma."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from beltscape.kernels import load
from beltscape.learned.registry import load_network
from beltscape.stereo.multiview.candidates import CandidateSelector, Selection
from beltscape.stereo.multiview.estimate import DepthEstimate, estimate_depth
from beltscape.stereo.multiview.features import (
    ConfidenceInputs,
    MatcherState,
    compute_image_features,
    compute_initial_features,
    compute_selection_features,
)
from beltscape.stereo.multiview.optimisation import propagate, solve_least_squares
from beltscape.stereo.multiview.refined_features import RefinementInputs
from beltscape.stereo.multiview.surface import fit_slopes
from beltscape.stereo.settings import MultiviewSettings
from tests.stereo.scenes import (
    cast_rays,
    compute_depth_mm,
    make_ring,
    make_scene,
    mask_away_from_steps,
    mask_inner,
    patch,
    plane,
    sphere,
    with_scale,
)

STEP = (plane(820), patch(560, (-90, 90), (-130, 130)))


def run_stages(made, s: np.ndarray) -> MatcherState:
    """Return the state after one propagation and least squares, as in the matcher's last round."""
    prepared = made.prepared
    propagated = propagate(fit_slopes(s.astype(np.float32), load(), 1), prepared, (2, 5))
    solution = solve_least_squares(propagated.surface, prepared, (0.7, 0.4), prepared.context.windows.wide)
    image, none = compute_image_features(prepared), np.zeros(s.shape, bool)
    return MatcherState(prepared, propagated, solution, image.planes, image.textured, none, None)


def with_selection(state: MatcherState) -> MatcherState:
    """Return the state with a selection that changes no pixel."""
    planes = compute_selection_features(ConfidenceInputs.from_state(state))
    selector = CandidateSelector.from_surface(state.solution.surface, planes, state.prepared)
    confidence, gain = planes["initial confidence"], selector.consistency.gain
    return replace(state, selection=Selection(state.solution.surface, confidence, gain))


SELECTIONS = pytest.mark.parametrize("selected", [False, True], ids=["initial features", "refined features"])


def estimate(made, s: np.ndarray, selected: bool) -> tuple[DepthEstimate, np.ndarray]:
    """Return the estimate of a surface, and the solved surface."""
    state = run_stages(made, s)
    if selected:
        state = with_selection(state)
    return estimate_depth(state), state.solution.surface.s


def surface_planes(state: MatcherState, scale: float) -> dict[str, np.ndarray]:
    """Return the initial features of a surface at another scale."""
    state = replace(state, prepared=with_scale(state.prepared, scale))
    return compute_initial_features(ConfidenceInputs.from_state(state))


def count_views_by_rays(made, solids) -> np.ndarray:
    """Return (H, W) the number of auxiliaries that see the true surface, by ray casting."""
    rig = made.rig
    z = compute_depth_mm(rig, solids)[..., None]
    points = np.concatenate([rig.core_camera.rays() * z, z], axis=-1)
    seen = np.zeros(z.shape[:2], np.uint8)
    for name in rig.auxiliaries:
        cam, pose = rig.cameras[name], rig.cam_from_core[name]
        at = pose.apply(points.reshape(-1, 3)).reshape(points.shape)
        hit = cast_rays(cam, pose, solids, at[..., :2] / at[..., 2:])
        pixels = cam.project(at.reshape(-1, 3)).reshape(*at.shape[:2], 2)
        inside = ((pixels >= 0) & (pixels <= np.array(cam.size_px) - 1)).all(axis=-1)
        seen += (inside & (np.abs(hit - points).max(axis=-1) < 1)).astype(np.uint8)
    return seen


@SELECTIONS
def test_features_of_every_network_are_computed(selected):
    state = with_selection(run_stages(made := make_scene(*STEP, noise=1.0), made.s))
    assert state.selection is not None
    inputs = ConfidenceInputs.from_state(state)
    if selected:
        found = RefinementInputs.from_selection(
            inputs, compute_initial_features(inputs), state.selection
        ).planes
        assert set(load_network("confidence").features) <= found.keys()
    else:
        found = compute_initial_features(inputs)
        assert {
            *load_network("initial_confidence").features,
            *load_network("fast_confidence").features,
        } <= found.keys()
    for name, value in found.items():
        assert np.isfinite(value).all(), name
        assert value.shape == made.s.shape


@pytest.mark.parametrize(
    ("name", "outputs"),
    [
        ("initial_confidence", 1),
        ("candidates", 1),
        ("confidence", 2),
        ("fast_confidence", 2),
        ("refinement", 48),
    ],
)
def test_shipped_layers_have_consistent_sizes(name, outputs):
    network = load_network(name)
    n = len(network.features)
    assert len(set(network.features)) == n
    assert (network.limits[0] <= network.limits[1]).all()
    assert network.limits.shape == (2, n)
    for layer in network.layers:
        assert layer.shape[1] == n + 1
        n = len(layer)
    assert n == outputs


def test_relief_and_brightness_features_have_the_named_values():
    made = make_scene(*STEP, noise=1.0)
    shaded = made.prepared.core.copy()
    shaded[40:70, 50:80] *= 0.3
    prepared = replace(made.prepared, core=shaded)
    state = run_stages(made, made.s)
    found = surface_planes(state, 1.0) | compute_image_features(with_scale(prepared)).planes
    shadow, rest = (slice(48, 62), slice(58, 72)), (slice(90, 110), slice(50, 80))
    assert (
        np.median(found["relative brightness within 11"][shadow])
        < np.median(found["relative brightness within 11"][rest]) - 0.1
    )
    assert (
        np.median(found["relative contrast within 11"][shadow])
        < np.median(found["relative contrast within 11"][rest]) - 0.5
    )
    for side in (5, 11, 21):
        s = state.solution.surface.s
        nearer, farther = found[f"nearer within {side}"], found[f"farther within {side}"]
        window = np.ones((side, side), np.uint8)
        span = cv2.dilate(s, window) - cv2.erode(s, window)
        np.testing.assert_allclose((nearer + farther)[span < 30], span[span < 30], atol=1e-3)


def test_distances_are_in_pixels_at_scale_one():
    made = make_scene(*STEP, noise=1.0)
    one, two = (surface_planes(run_stages(made, made.s), scale) for scale in (1.0, 2.0))
    for name in ("step proximity", "wide step proximity"):
        np.testing.assert_allclose(two[name] ** 2, one[name], atol=1e-6)
    off = one["offset from median"]
    assert (off > 0).any()
    np.testing.assert_allclose(two["offset from median"][off < 1], off[off < 1] / 2, atol=1e-6)


def test_slope_deviation_is_large_on_round_flanks_and_last_update_small_without_change():
    flat, round_ = make_scene(plane(), noise=1.0), make_scene(sphere(660, 60), plane(800), noise=1.0)
    found = []
    for made in (flat, round_):
        state = run_stages(made, made.s)
        still = replace(state, propagated=replace(state.propagated, surface=state.solution.surface))
        moved, left = (surface_planes(one, 1.0) for one in (state, still))
        assert (left["last update"] <= moved["last update"] + 1e-5).all()
        assert np.ptp(left["last update"]) < 1e-5
        found.append(moved)
    height, width = flat.s.shape
    flank = slice(height // 2 - 3, height // 2 + 4), slice(width // 2 + 8, width // 2 + 15)
    for name in ("slope deviation", "wide slope deviation"):
        assert np.median(found[1][name][flank]) > np.median(found[0][name][flank]) + 0.5


@SELECTIONS
@pytest.mark.parametrize("angles", [(0,), (0, 30), (0, 90, 180, 270)])
def test_occluded_pixels_have_no_confidence(angles, selected):
    made = make_scene(*STEP, rig=make_ring(angles), noise=1.0)
    estimated, _ = estimate(made, made.s, selected)
    truth = count_views_by_rays(made, STEP)
    clear = cv2.erode(truth, np.ones((7, 7))) == cv2.dilate(truth, np.ones((7, 7)))
    hidden, seen = clear & (truth == 0), clear & (truth > 0) & mask_inner(truth.shape, 8)
    if len(angles) < 4:
        assert hidden.sum() > 100
        assert not estimated.confidence[hidden].any()
        assert not estimated.views[hidden].any()
    assert (estimated.confidence[seen] > 0.5).mean() > 0.95
    assert (estimated.views[seen] == truth[seen]).mean() > 0.95
    assert estimated.views.max() <= len(angles)


@SELECTIONS
def test_false_surfaces_have_less_confidence_than_right_ones(selected):
    made = make_scene(plane(), noise=1.0)
    wrong = mask_inner(made.s.shape, 30)
    estimated, s = estimate(made, np.where(wrong, made.s + 5, made.s), selected)
    error = np.abs(s - made.s)
    false, right = error > 1, (error < 0.1) & mask_inner(s.shape, 8)
    assert false.sum() > 0.5 * wrong.sum()
    ranks = np.searchsorted(np.sort(estimated.confidence[right]), estimated.confidence[false]) / right.sum()
    assert ranks.mean() < 0.1  # probability that a false pixel has more confidence than a right one
    assert (estimated.confidence[false] < MultiviewSettings().least_confidence).mean() > 0.9
    assert (estimated.confidence[right] > 0.9).mean() > 0.9


@SELECTIONS
def test_confidence_is_a_probability_and_sigma_is_positive(selected):
    made = make_scene(*STEP, noise=3.0)
    s = made.s.copy()
    s[30:50, 20:40] = np.nan
    estimated, left = estimate(made, s, selected)
    assert estimated.confidence.dtype == estimated.sigma.dtype == np.float32
    assert ((estimated.confidence >= 0) & (estimated.confidence <= 1)).all()
    assert not estimated.confidence[np.isnan(left)].any()
    assert (estimated.sigma[estimated.confidence > 0] > 0).all()


@SELECTIONS
def test_textureless_region_is_measured_only_if_filled(selected):
    made = make_scene(plane(), noise=1.0)
    state = run_stages(made, made.s)
    state = with_selection(state) if selected else state
    core = made.prepared.core.copy()
    v, u = np.mgrid[: core.shape[0], : core.shape[1]].astype(np.float32)
    shaded = u >= 60
    core[shaded] = (40 + 0.9 * u + 0.5 * v + np.random.default_rng(1).normal(0, 1, core.shape))[shaded]
    disc = (u - 90) ** 2 + (v - 50) ** 2 < 8**2
    state = replace(state, prepared=with_scale(state.prepared))
    blind = replace(state.prepared, core=core)
    blind = replace(state, prepared=blind, textured=compute_image_features(blind).textured)
    inside = shaded & (u > 60 + 12) & mask_inner(core.shape, 6)
    assert (estimate_depth(state).confidence[inside] > 0.5).mean() > 0.9
    assert (estimate_depth(blind).confidence[inside] == 0).all()
    kept = estimate_depth(replace(blind, filled=disc)).confidence
    assert (kept[inside & ~disc] == 0).all()
    assert (kept[disc] > 0).all()


@SELECTIONS
def test_sigma_is_larger_on_round_flanks_than_on_a_plane(selected):
    flat, round_ = make_scene(plane(), noise=1.0), make_scene(sphere(660, 60), plane(800), noise=1.0)
    height, width = flat.s.shape
    flank = slice(height // 2 - 3, height // 2 + 4), slice(width // 2 + 8, width // 2 + 15)
    on_plane, on_flank = (
        np.median(estimate(made, made.s, selected)[0].sigma[flank]) for made in (flat, round_)
    )
    assert on_flank > 1.3 * on_plane


@SELECTIONS
def test_sigma_grows_with_the_noise(selected):
    def median_sigma(noise):
        made = make_scene(plane(), noise=noise)
        return np.median(estimate(made, made.s, selected)[0].sigma[mask_away_from_steps(made.s, 8)])

    assert median_sigma(8.0) > 1.5 * median_sigma(2.0)
