"""The control picture names every camera and marks the detected markers."""

from __future__ import annotations

import numpy as np

from beltscape.core.frames import FrameSet
from beltscape.report.control_pictures import draw_camera_regions, draw_regions
from beltscape.report.drawing.pictures import PANEL_PX
from beltscape.stereo.markers.grid import detect_marker_grid
from tests.stereo.projected import make_view, render_pattern


def test_detected_and_predicted_markers_have_different_colours():
    hidden = np.zeros((4, 4), bool)
    hidden[1, 1] = True
    image = render_pattern(make_view(), hidden=hidden)
    grid = detect_marker_grid(image)
    assert grid is not None
    drawn = draw_camera_regions(image, grid)
    assert drawn.shape == (750, 900, 3) and drawn.dtype == np.uint8
    factor = 900 / 816
    for row, column, color in ((0, 0, (80, 255, 120)), (1, 1, (255, 160, 60))):
        u, v = (grid.center_px[row, column] * factor).astype(int)
        assert (np.abs(drawn[v - 18 : v + 19, u - 18 : u + 19].astype(int) - color).max(axis=2) < 20).any()


def test_cameras_without_markers_are_shown_too():
    image = render_pattern(make_view())
    grid = detect_marker_grid(image)
    assert grid is not None
    frames = FrameSet("000", {"cam0": image, "cam1": image, "cam2": image, "cam3": np.zeros_like(image)})
    shown = draw_regions(frames, {"cam0": grid, "cam1": grid, "cam2": grid})
    assert shown.shape[1] == 3 * PANEL_PX and shown.shape[0] > 2 * 600
