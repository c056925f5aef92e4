"""Small 3-D scenes: rigs, lenses and values that the viewer accepts."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from beltscape.report.drawing.scene import Scene, make_rig_scene
from tests.synthetic.boards import row_of_cameras


def test_a_rig_is_frusta_and_names():
    rig = row_of_cameras(["a", "b"])
    scene = json.loads(make_rig_scene(rig, length_mm=200.0).to_json())
    assert [text for text, _ in scene["labels"]] == ["a", "b"]
    assert len(scene["lines"]) == 2 * 5
    assert scene["labels"][0][1] == [0.0, 0.0, 0.0]


def test_a_lens_that_does_not_reach_its_corners_is_drawn_all_the_same():
    rig = row_of_cameras(["a", "b"])
    strong = replace(rig.cameras["b"], distortion=np.array([-0.9, 0.0, 0.0, 0.0, 0.0]))
    assert np.isnan(strong.undistort(np.zeros((1, 2)))).any()
    scene = json.loads(
        make_rig_scene(replace(rig, cameras={**rig.cameras, "b": strong}), length_mm=200.0).to_json()
    )
    assert np.isfinite([point for _, line in scene["lines"] for point in line]).all()


def test_what_the_viewer_cannot_parse_is_refused_here():
    with pytest.raises(ValueError, match="not JSON compliant"):
        Scene(points_mm=np.full((1, 3), np.nan), colors=np.zeros((1, 3), np.uint8)).to_json()
