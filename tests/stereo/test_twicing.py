"""Twicing: the flattening of round tops is corrected, planes and NaN do not change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.kernels import load
from beltscape.stereo.multiview.frame import choose_windows
from beltscape.stereo.multiview.optimisation import apply_twicing, solve_least_squares
from beltscape.stereo.multiview.surface import Surface, fit_slopes
from tests.stereo.scenes import (
    Scene,
    make_scene,
    mask_away_from_steps,
    mask_inner,
    plane,
    sphere,
    with_context,
)

SIZE = replace(choose_windows(1224), levels_px=4)
"""Windows that flatten the small scenes."""
BALL = (sphere(660, 250), plane(900))


def run_twicing(made: Scene, s: np.ndarray | None = None) -> tuple[Surface, Surface]:
    surface = fit_slopes((made.s if s is None else s).astype(np.float32), load(), 1)
    prepared = with_context(made.prepared, windows=SIZE)
    solved = solve_least_squares(surface, prepared, (0.7, 0.4), SIZE.firm).surface
    return solved, apply_twicing(solved, prepared, 0.4)


def mask_top(made: Scene) -> np.ndarray:
    """Return the (H, W) mask of the ball where no window extends beyond its rim."""
    return mask_away_from_steps(made.s, 9) & mask_inner(made.s.shape, 9) & (made.s > np.median(made.s))


def test_twicing_restores_a_round_top():
    made = make_scene(*BALL, noise=1.0)
    top = mask_top(made)
    flattened, sharp = ((surface.s - made.s)[top] for surface in run_twicing(made))
    assert top.sum() > 100
    assert abs(np.mean(sharp)) < 0.6 * abs(np.mean(flattened))
    assert np.median(np.abs(sharp)) < 0.9 * np.median(np.abs(flattened))


@pytest.mark.parametrize("noise", [1.0, 4.0])
def test_twicing_does_not_change_a_plane(noise):
    """Noise may grow by a tenth."""
    made = make_scene(plane(700, 0.2), noise=noise)
    where = mask_inner(made.s.shape, 12)
    flat, sharp = ((surface.s - made.s)[where] for surface in run_twicing(made))
    assert np.std(sharp) < 1.1 * np.std(flat)


def test_nan_stays_and_does_not_spread():
    made = make_scene(plane(), noise=1.0)
    s = made.s.copy()
    s[40:50, 50:60] = np.nan
    flat, sharp = run_twicing(made, s)
    np.testing.assert_array_equal(np.isnan(flat.s), np.isnan(sharp.s))
    assert np.isfinite(sharp.slope_u[np.isfinite(flat.slope_u)]).all()
