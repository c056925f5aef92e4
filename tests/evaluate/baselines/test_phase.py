"""Phases of synthetic fringes are found exactly; σ says how noise moves them; contradictions are refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.evaluate.structured_light import Phase, estimate_phase, unwrap_phases
from beltscape.simulate.projected_sequence import FringeSettings, make_fringe_patterns
from tests.thorough import examples


def images_of(phase: np.ndarray, steps: int, mean: float = 100.0, modulation: float = 60.0) -> np.ndarray:
    shifts = 2 * np.pi * np.arange(steps) / steps
    return mean + modulation * np.cos(phase - shifts[:, None, None])


@given(steps=st.integers(3, 12), seed=st.integers(0, 2**32 - 1))
def test_phase_and_modulation_are_exact(steps: int, seed: int):
    true = np.random.default_rng(seed).uniform(0, 2 * np.pi, (4, 5))
    found = estimate_phase(images_of(true, steps), np.ones((4, 5)))
    np.testing.assert_allclose(np.exp(1j * found.phase), np.exp(1j * true), atol=1e-9)
    np.testing.assert_allclose(found.modulation, 60.0, rtol=1e-9)


def test_sigma_equals_the_scatter_by_noise():
    rng = np.random.default_rng(3)
    true = np.full((200, 200), 2.0)
    found = estimate_phase(images_of(true, 4) + rng.normal(0, 1.5, (4, 200, 200)), np.full((200, 200), 1.5))
    assert found.phase.std() == pytest.approx(np.median(found.sigma), rel=0.02)


def test_without_modulation_sigma_is_infinite():
    found = estimate_phase(np.full((4, 1, 1), 50.0), np.ones((1, 1)))
    assert not np.isfinite(found.sigma).any() or found.sigma.min() > 1e6


@examples(20)
@given(st.lists(st.floats(2.5, 7.5), min_size=1, max_size=3))
def test_columns_of_pictures_are_found_exactly(ratios: list[float]):
    fringes = FringeSettings(fringes=tuple(np.cumprod([1.0, *ratios])), steps=5)
    pictures = make_fringe_patterns(fringes, (640, 1)).reshape(len(fringes.fringes), 5, 1, 640)
    phases = [estimate_phase(one, np.full((1, 640), 0.002)) for one in pictures]
    column, sigma = unwrap_phases(phases, fringes.periods_px(640), gate=6.0)
    off = np.mod(column[0] - np.arange(640) + 320, 640) - 320  # where the coarse fringe begins it also ends
    np.testing.assert_allclose(off[1:], 0, atol=1e-2)
    assert np.isfinite(sigma[0, 1:]).all()


def test_sets_that_contradict_each_other_are_refused():
    coarse = Phase(np.array([[1.0, 1.0]]), np.ones((1, 2)), np.full((1, 2), 0.01))
    column = 1.0 / (2 * np.pi) * 640
    fine_phase = np.mod(np.array([[column, column + 30]]) / 80 * 2 * np.pi, 2 * np.pi)
    fine = Phase(fine_phase, np.ones((1, 2)), np.full((1, 2), 0.01))
    found, sigma = unwrap_phases([coarse, fine], (640.0, 80.0), gate=6.0)
    assert found[0, 0] == pytest.approx(column)
    assert np.isnan(found[0, 1])
    assert np.isnan(sigma[0, 1])
