"""Estimation of a frame's noise from the residuals of its surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.kernels import load
from beltscape.stereo.multiview.frame import Noise
from beltscape.stereo.multiview.pyramid import estimate_noise
from beltscape.stereo.multiview.surface import Surface, fit_slopes
from tests.stereo.scenes import DEPTH_MM, make_ring, make_scene, plane

SLANTED = plane(DEPTH_MM, 0.2, 0.1)


def estimate_from(made, initial: Noise, wrong_px: float = 0.0) -> Noise:
    surface = fit_slopes(made.s + np.float32(wrong_px), load(), 1)
    return estimate_noise(surface, replace(made.prepared, noise=initial))


@pytest.mark.parametrize("noise", [2.0, 6.0])
@pytest.mark.parametrize("wrong_by", [1 / 10, 1.0, 20.0])
@pytest.mark.parametrize("angles", [(0,), (0, 90, 180, 270)])
def test_wrong_initial_noise_is_scaled_to_the_residuals(noise, wrong_by, angles):
    made = make_scene(SLANTED, rig=make_ring(angles), noise=noise)
    initial = Noise(noise**2 * wrong_by, 1e-6, made.prepared.noise.texture)
    found = estimate_from(made, initial)
    assert 0.5 < found.levels / noise**2 < 2.0
    assert found.model / initial.model == pytest.approx(found.levels / initial.levels)
    assert found.texture == initial.texture


def test_slightly_wrong_surface_raises_the_noise_only_slightly():
    made = make_scene(SLANTED, noise=4.0)
    initial = Noise(16.0, 1e-4, made.prepared.noise.texture)
    assert estimate_from(made, initial).levels < estimate_from(made, initial, 0.1).levels < 2.5 * 16


def test_completely_wrong_surface_raises_the_noise_up_to_a_limit():
    made = make_scene(SLANTED, noise=1.0)
    initial = Noise(1.0, 1e-6, made.prepared.noise.texture)
    assert estimate_from(made, initial, 15).levels <= 64


def test_noise_without_a_surface_is_unchanged():
    made = make_scene(SLANTED)
    nothing = np.full_like(made.s, np.nan)
    found = estimate_noise(Surface(nothing, nothing, nothing), made.prepared)
    assert found == made.prepared.noise
