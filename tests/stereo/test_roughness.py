"""Roughness features: disagreement of windows over patches, without depth steps and unseen pixels."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from beltscape.kernels import load
from beltscape.stereo.multiview.frame import choose_windows
from beltscape.stereo.multiview.optimisation import LeastSquaresResult, solve_least_squares
from beltscape.stereo.multiview.refined_features import compute_roughness_features
from beltscape.stereo.multiview.surface import Surface, fit_slopes
from tests.stereo.scenes import make_inputs, make_scene, plane, sphere, with_scale

SHAPE = (120, 160)


def make_flat_result(s: np.ndarray | None = None, **fields: Any) -> LeastSquaresResult:
    """Return a flat surface whose windows agree, with one variance."""
    s = np.full(SHAPE, 200, np.float32) if s is None else s.astype(np.float32)
    none = np.zeros(s.shape, np.float32)
    made = LeastSquaresResult(
        Surface(s, none, none),
        none + 1e-4,  # pyrefly: ignore[bad-argument-type]
        none,
        np.full(s.shape, 4, np.uint8),
        none + 50,
    )
    return replace(made, **fields)


def compute_features(solution: LeastSquaresResult, scale: float = 1.0) -> dict[str, np.ndarray]:
    """Return the features of a surface with one slope deviation."""
    prepared = with_scale(make_scene(plane()).prepared, scale)
    slope_deviation = np.full(solution.surface.s.shape, -5, np.float32)
    return dict(compute_roughness_features(make_inputs(prepared, solution), slope_deviation))


@pytest.mark.parametrize("scale", [0.5, 1.0, 1.8])
def test_features_of_constant_planes_are_the_constants(scale):
    found = compute_features(make_flat_result(disagreement=np.full(SHAPE, 3, np.float32)), scale=scale)
    assert len(found) == 8
    for name, plane_ in found.items():
        expected = {
            "window disagreement": np.log(3.01),
            "slope deviation": -5.0,
            "log sigma": np.log(0.01),
        }
        np.testing.assert_allclose(plane_, expected[name.split(" within")[0]], rtol=1e-4, err_msg=name)


def test_features_depend_on_the_pixels_of_their_window():
    disagreement = np.zeros(SHAPE, np.float32)
    disagreement[60, 80] = 25
    found = compute_features(make_flat_result(disagreement=disagreement))
    for window_px in (5, 15, 41, 101):
        wide = found[f"window disagreement within {window_px}"] > np.log(0.01) + 1e-3
        columns = np.flatnonzero(wide.any(axis=0))
        assert abs(np.ptp(columns) + 1 - window_px) <= 8 * (window_px > 15)


def test_features_exclude_depth_steps_and_pixels_without_agreeing_view():
    s = np.full(SHAPE, 200.0)
    s[:, 80:] = 220
    disagreement, used = np.zeros(SHAPE, np.float32), np.full(SHAPE, 4, np.uint8)
    disagreement[:, 78:82] = 25
    disagreement[:20, :20], used[:20, :20] = 25, 0
    found = compute_features(make_flat_result(s, disagreement=disagreement, used=used))
    for window_px in (5, 15, 41, 101):
        np.testing.assert_allclose(found[f"window disagreement within {window_px}"], np.log(0.01), rtol=1e-5)


def test_features_are_finite_around_nan():
    s = np.full(SHAPE, 200.0)
    s[40:60, 40:70] = np.nan
    missing = np.isnan(s)
    holes = {
        "disagreement": np.where(missing, np.nan, 1).astype(np.float32),
        "variance": np.where(missing, np.nan, 1e-4).astype(np.float32),
        "used": np.where(missing, 0, 4).astype(np.uint8),
    }
    for name, plane_ in compute_features(make_flat_result(s, **holes)).items():
        assert np.isfinite(plane_).all(), name


def test_surface_that_bends_within_a_window_has_more_disagreement():
    features = []
    for solids in ((plane(),), (sphere(660, 60), plane(800))):
        made = make_scene(*solids, noise=1.0)
        size = choose_windows(made.s.shape[1])
        surface = fit_slopes(made.s.astype(np.float32), load(), 1)
        solution = solve_least_squares(surface, made.prepared, (0.7, 0.4), size.wide)
        middle = tuple(side // 2 for side in made.s.shape)
        features.append(compute_features(solution, scale=size.scale)["window disagreement within 15"][middle])
    assert features[1] > features[0] + 0.5
