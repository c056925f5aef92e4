"""Dense least squares: accuracy of the solution, and of its variance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.kernels import load
from beltscape.stereo.multiview.frame import Noise
from beltscape.stereo.multiview.optimisation import LeastSquaresResult, solve_least_squares
from beltscape.stereo.multiview.surface import fit_slopes
from tests.stereo.scenes import (
    DEPTH_MM,
    make_ring,
    make_scene,
    mask_away_from_steps,
    mask_inner,
    patch,
    plane,
    sphere,
)
from tests.thorough import list_cases

SHAPES = {
    "plane": (plane(),),
    "slanted": (plane(DEPTH_MM, 0.3, -0.2),),
    "sphere": (sphere(640, 900), plane(1100)),
}
RIGS = {
    "four about": make_ring(),
    "one beside": make_ring((0,)),
    "two diagonal, parallel": make_ring((40, 220), parallel=True),
}


def solve_from(
    made, s: np.ndarray, tolerances=(2.0, 2.0, 1.0, 0.5), noise: Noise | None = None
) -> LeastSquaresResult:
    prepared = made.prepared if noise is None else replace(made.prepared, noise=noise)
    start = fit_slopes(s.astype(np.float32), load(), 1)
    return solve_least_squares(start, prepared, tolerances, prepared.context.windows.wide)


def mask_seen_by_all(made, solution: LeastSquaresResult, margin_px: int = 8) -> np.ndarray:
    return (solution.used == len(made.auxiliaries)) & mask_inner(made.s.shape, margin_px)


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("wrong_px", [0.7, -0.7])
def test_solution_from_most_of_a_pixel_away_converges_to_the_truth(rig, shape, wrong_px):
    made = make_scene(*SHAPES[shape], rig=RIGS[rig], noise=0.5)
    solution = solve_from(made, made.s + np.float32(wrong_px))
    where = mask_seen_by_all(made, solution)
    error = (solution.surface.s - made.s)[where]
    assert where.mean() > 0.25
    assert np.median(np.abs(error)) < 0.02
    assert abs(np.median(error)) < (0.02 if shape == "sphere" else 0.005)  # windows flatten bends
    assert (np.abs(error) < 0.1).mean() > 0.98


def test_slopes_of_the_solution_are_those_of_the_plane():
    made = make_scene(plane(DEPTH_MM, 0.3, -0.2), noise=0.5)
    solution = solve_from(made, made.s + np.float32(0.7))
    where = mask_seen_by_all(made, solution)
    true_v, true_u = np.gradient(made.s.astype(float))
    assert np.abs(solution.surface.slope_u - true_u)[where].max() < 0.1
    assert np.median(np.abs(solution.surface.slope_u - true_u)[where]) < 0.015
    assert np.median(np.abs(solution.surface.slope_v - true_v)[where]) < 0.015


def test_solution_keeps_depth_steps():
    made = make_scene(plane(740), patch(660, (-150, 60), (-120, 120)), noise=0.5)
    solution = solve_from(made, made.s)
    middle = (made.s.min() + made.s.max()) / 2
    assert np.array_equal(solution.surface.s > middle, made.s > middle)
    along = ~mask_away_from_steps(made.s, 2) & mask_inner(made.s.shape, 8)
    error = np.abs(solution.surface.s - made.s)
    assert along.sum() > 400
    assert np.median(error[along]) < 0.1
    assert (error[mask_away_from_steps(made.s, 6) & mask_seen_by_all(made, solution)] < 0.1).mean() > 0.98


@pytest.mark.parametrize("angles", [(0,), (0, 30), (0, 90, 180, 270), (0, 20, 40, 60)])
@pytest.mark.parametrize("noise", list_cases([2.0, 5.0], [5.0]))
def test_variance_equals_that_of_repeated_noise(angles, noise):
    """Views count as independent but share the core's noise, which cancels between opposite ones (ratio 0.7)."""
    known = Noise(noise**2, 1e-4, 0.0)
    made = [make_scene(plane(), rig=make_ring(angles), noise=noise, seed=seed) for seed in range(8)]
    runs = [solve_from(one, one.s, (0.5, 0.5), known) for one in made]
    everywhere = np.logical_and.reduce([mask_seen_by_all(made[0], run) for run in runs])
    assert everywhere.mean() > 0.4
    actual = np.var([run.surface.s[everywhere] for run in runs], axis=0, ddof=1)
    stated = np.mean([run.variance[everywhere] for run in runs], axis=0)
    ratio = np.sqrt(np.mean(actual) / np.mean(stated))
    assert (0.8 if len(angles) == 1 else 0.6) < ratio < 1.4


def test_variance_falls_with_more_views_and_less_noise():
    def median_variance(rig, noise):
        made = make_scene(plane(), rig=rig, noise=noise)
        solution = solve_from(made, made.s, (0.5,), Noise(noise**2, 1e-4, 0.0))
        return np.median(solution.variance[mask_seen_by_all(made, solution)])

    four = median_variance(make_ring(), 2.0)
    assert median_variance(make_ring(), 6.0) > 4 * four
    assert median_variance(make_ring((0,)), 2.0) > 2 * four


def test_nan_stays_and_does_not_spread():
    made = make_scene(plane(), noise=0.5)
    hole = ~np.array(mask_away_from_steps(made.s, 1))
    hole[40:60, 50:70] = True
    hole |= np.random.default_rng(4).random(hole.shape) < 0.02
    solution = solve_from(made, np.where(hole, np.nan, made.s + 0.3))
    assert np.array_equal(np.isnan(solution.surface.s), hole)
    assert not solution.used[hole].any()
    where = mask_seen_by_all(made, solution) & ~hole
    assert (np.abs(solution.surface.s - made.s)[where] < 0.1).mean() > 0.98


def test_solving_without_tolerances_is_refused():
    made = make_scene(plane())
    with pytest.raises(ValueError, match="at least one tolerance"):
        solve_from(made, made.s, ())
