"""Holes learn from places that few frames measured how much too high they are filled."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.measure.flow.crevices import Crevices
from beltscape.measure.holes import Filled, fill_holes

LEVEL = np.zeros((2, 120, 120))


def grooves(depth_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Steps of 40 mm with grooves beside them, and where these are."""
    x = np.arange(120)
    height = np.where((x // 20) % 2 == 0, 40.0, 0.0)[None].repeat(120, axis=0)
    groove = ((x % 20) < 3)[None].repeat(120, axis=0)
    return np.where(groove, np.minimum(height, 20.0) - depth_mm, height), groove


def learned(depth_mm: float) -> Crevices:
    height, groove = grooves(depth_mm)
    crevices = Crevices()
    for _ in range(5):
        crevices.learn(height, np.full(height.shape, 0.1), np.where(groove, 0.3, 1.0), 1.0, LEVEL)
    return crevices


def test_deep_grooves_lower_the_holes_and_high_ones_never_raise_them() -> None:
    assert learned(30.0).factors.max() > 0.3
    assert learned(-40.0).factors.max() == 0.0
    assert Crevices().factors.max() == 0.0


def test_only_holes_are_lowered() -> None:
    height, groove = grooves(30.0)
    holes = np.where(groove, np.nan, height)
    filled = fill_holes(holes, np.where(groove, np.nan, 0.1), np.zeros(groove.shape, bool), 1.0, LEVEL)
    lowered = learned(30.0).lowered(filled)
    assert isinstance(lowered, Filled)
    np.testing.assert_array_equal(lowered.value_mm[~groove], height[~groove])
    before = np.abs(filled.value_mm - height)[groove].mean()
    assert np.abs((lowered.value_mm - height)[groove].mean()) < before
    assert lowered.sigma_mm == pytest.approx(filled.sigma_mm)
