"""Ceilings of the accuracy: each better decision reaches at least as much as the one before."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from beltscape.kernels import load
from tests.synthetic.demo import SMALL_CAMERAS, crop_demo_rig, read_cropped_frame, read_cropped_truth

pytestmark = pytest.mark.slow


def test_better_decisions_reach_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    names = "ceiling", "captures", "matching.scenes", "matching.visibility"
    ceiling, captures, scenes, visibility = (import_module(name) for name in names)
    rig, true_mm = crop_demo_rig(SMALL_CAMERAS), read_cropped_truth("belt_loaded").astype(np.float64)
    whole = np.isfinite(true_mm)
    occluded = captures.occluded_mask(rig, true_mm, load()) & whole
    frame = read_cropped_frame("belt_loaded", SMALL_CAMERAS)
    loaded = captures.Scene("belt_loaded", rig, frame, true_mm, whole, occluded)
    # a projector at the place of an auxiliary lights what that one sees
    projector = replace(rig.cameras["cam1"], name="projector")
    lit_from_cam1 = visibility.find_visibility(
        rig, loaded.true_depth_mm, projector, rig.cam_from_core["cam1"]
    )
    one = scenes.AblationScene(loaded, None, lit_from_cam1)
    (reached, from_truth, accepted, selected, within_2mm, blank), classes = ceiling.measure_ceilings(one)
    assert 0.5 < reached < accepted < selected < within_2mm <= 1
    assert reached < from_truth < 1
    assert 0 <= blank < 0.1
    assert sum(share for share, _ in classes.values()) == pytest.approx(1)
    assert sum(missed for _, missed in classes.values()) == pytest.approx(1 - reached)
    assert 0.02 < classes["in shadow"][0] < 0.3
    assert not (lit_from_cam1.lit & (lit_from_cam1.views == 0)).any()
    assert classes["unseen"][0] == pytest.approx(loaded.occluded[loaded.region].mean(), abs=0.005)
    for name in ("unseen", "one view", "near a step"):  # worse than elsewhere
        share, missed = classes[name]
        assert missed / share > classes["elsewhere"][1] / classes["elsewhere"][0]
