"""Ceilings of the accuracy: each better decision reaches at least as much as the one before."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.slow


def test_better_decisions_reach_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    ceiling, captures, scenes = (import_module(name) for name in ("ceiling", "captures", "matching.scenes"))
    loaded = captures.demo_scenes()[-1]
    one = scenes.AblationScene(loaded, None, None)
    reached, accepted, selected, within_2mm, unseen, one_view, blank = ceiling.measure_ceilings(one)
    assert 0.5 < reached < accepted < selected < within_2mm <= 1
    assert np.isnan(unseen)
    assert np.isnan(one_view)
    assert 0 <= blank < 0.1
