"""The depth range of a frame contains its surface with small margins."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.stereo.multiview.depth_range import find_depth_range
from tests.stereo import raycast
from tests.stereo.raycast import compute_true_depth, make_world_rig, render_frame
from tests.stereo.rendered import needs_rendered, read_halved_frames, read_halved_rig, read_halved_truth
from tests.thorough import list_cases

RIGS: dict[str, dict[str, Any]] = {
    "five": {},
    "higher": {"height_mm": 1100, "baseline_mm": 300},
    "lower": {"height_mm": 520, "baseline_mm": 120},
    "parallel pair": {"parallel": True, "baseline_mm": 120, "angles_deg": (0,)},
    "short parallel pair": {"parallel": True, "baseline_mm": 60, "angles_deg": (90,)},
    "diagonal pair": {"angles_deg": (45,)},
    "eight": {"angles_deg": (0, 51, 103, 154, 206, 257, 309)},
}


FEW = ("short parallel pair",)


@pytest.mark.parametrize("name", list_cases(RIGS, FEW))
def test_range_contains_the_surface_with_small_margins(name):
    rig, core_from_world = make_world_rig(**RIGS[name])
    near, far = find_depth_range(rig, render_frame(rig, core_from_world), Silent())
    truth = compute_true_depth(rig, core_from_world)
    assert 0.85 * truth.min() < near < truth.min()
    assert truth.max() < far < 1.15 * truth.max()


def test_range_contains_a_slender_cylinder(monkeypatch):
    monkeypatch.setattr(raycast, "CYLINDER", (20.0, 40.0, 10.0, 160.0))  # far above all else
    rig, core_from_world = make_world_rig()
    near, far = find_depth_range(rig, render_frame(rig, core_from_world), Silent())
    truth = compute_true_depth(rig, core_from_world)
    assert 0.85 * truth.min() < near < truth.min()
    assert truth.max() < far < 1.15 * truth.max()


def test_images_without_texture_are_refused():
    rig, _ = make_world_rig(angles_deg=(0,))
    blank = FrameSet("007", {name: np.full((320, 400), 90, np.uint8) for name in rig.cameras})
    with pytest.raises(ReconstructionError, match="frame 007: no surface found"):
        find_depth_range(rig, blank, Silent())


@pytest.mark.thorough
@needs_rendered
@pytest.mark.parametrize("scene", ["belt_empty", "module", "belt_loaded"])
def test_range_contains_rendered_surfaces_with_small_margins(scene):
    truth, _ = read_halved_truth(scene)
    near, far = find_depth_range(read_halved_rig(), read_halved_frames(scene), Silent())
    assert 0.9 * np.nanmin(truth) < near < np.nanmin(truth)
    assert np.nanmax(truth) < far < 1.1 * np.nanmax(truth)
