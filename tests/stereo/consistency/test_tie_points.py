"""Tie points that a depth map guides to: none where a nearer surface hides the patch from an auxiliary."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.tie_points import match_guided
from tests.synthetic.light import camera

WIDTH_PX, HEIGHT_PX, FOCAL_PX, BASELINE_MM = 240, 200, 300.0, 200.0
NEAR_MM, FAR_MM, EDGE_PX = 650.0, 750.0, 120
HIDDEN_PX = FOCAL_PX * BASELINE_MM * (1 / NEAR_MM - 1 / FAR_MM)
"""Width of the strip beside the step that an auxiliary on the step's other side does not see."""


@pytest.fixture(scope="module")
def searched():
    """Return the middle row's columns, and which of them are searched in the left and the right auxiliary."""
    cameras = {
        name: camera(WIDTH_PX, HEIGHT_PX, FOCAL_PX, (0.0,) * 5, name) for name in ("core", "left", "right")
    }
    shifts = {"core": 0.0, "left": BASELINE_MM, "right": -BASELINE_MM}
    rig = Rig("core", cameras, {name: Pose.of([0, 0, 0], [x, 0, 0]) for name, x in shifts.items()})
    depth_mm = np.full((HEIGHT_PX, WIDTH_PX), NEAR_MM, np.float32)
    depth_mm[:, EDGE_PX:] = FAR_MM
    rng = np.random.default_rng(0)
    images = {name: rng.integers(0, 255, (HEIGHT_PX, WIDTH_PX), np.uint8) for name in cameras}
    columns = np.arange(EDGE_PX - 60, EDGE_PX + 60)
    points = np.column_stack([columns, np.full(len(columns), HEIGHT_PX / 2)]).astype(np.float64)
    found = match_guided(
        FrameSet("000", images),
        rig,
        ("left", "right"),
        DepthMap(
            depth_mm,
            np.full_like(depth_mm, 0.1),
            np.full(depth_mm.shape, 2, np.uint8),
            np.ones_like(depth_mm),
        ),
        points,
    )
    return found.core_px[:, 0], found.searched["left"], found.searched["right"]


def test_a_patch_behind_a_step_is_not_searched(searched):
    columns, left, _ = searched
    behind = (columns > EDGE_PX) & (columns < EDGE_PX + HIDDEN_PX)
    assert HIDDEN_PX > 10
    assert behind.any()
    assert not left[behind].any()


def test_other_patches_are_searched(searched):
    columns, left, right = searched
    clear = (columns < EDGE_PX - 8) | (columns > EDGE_PX + HIDDEN_PX + 8)
    in_left, in_right = columns < WIDTH_PX - 100, columns > 100
    assert clear.any()
    assert left[clear & in_left].all()
    assert right[clear & in_right].all()
    assert right[(columns > EDGE_PX + 8) & in_right].all()
