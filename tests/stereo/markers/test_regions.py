"""Numbering of markers in any view, with hidden and false markers, and the regions of the pattern."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.stereo.markers.detection import MarkerDetections
from beltscape.stereo.markers.grid import arrange_in_grid, compute_region_outline, detect_marker_grid
from tests.stereo.projected import MARKERS, compute_luminance, make_view, project_points, render_pattern
from tests.thorough import THOROUGH, list_cases, list_rows

SIZE = (816, 680)


def _make_detections(points: np.ndarray, radius: float = 10.0, confidence: float = 0.9) -> MarkerDetections:
    return MarkerDetections(
        points.reshape(-1, 2), np.full(points.size // 2, radius), np.full(points.size // 2, confidence)
    )


def _join(a: MarkerDetections, b: MarkerDetections) -> MarkerDetections:
    parts = ((a.center_px, b.center_px), (a.radius_px, b.radius_px), (a.confidence, b.confidence))
    return MarkerDetections(*(np.concatenate(pair) for pair in parts))


@pytest.mark.parametrize(("hidden", "share"), list_rows([(0, 0.9), (3, 0.8), (6, 0.6)], [(0, 0.9), (3, 0.8)]))
def test_numbering_is_right_with_hidden_displaced_and_false_markers(hidden, share):
    """All markers are displaced by up to 5 % of a step, some are hidden, and two are false."""
    rng = np.random.default_rng(hidden)
    right = mislabelled = 0
    tries = 10 if THOROUGH else 5
    for _ in range(tries):
        true = project_points(MARKERS, make_view(SIZE, rng.uniform(-20, 20), rng.uniform(-0.25, 0.25)))
        step = np.linalg.norm(true[1, 1] - true[2, 1])
        moved = true + rng.uniform(-0.05, 0.05, true.shape) * step
        gone = np.zeros(16, bool)
        gone[rng.choice(16, hidden, replace=False)] = True
        gone = gone.reshape(4, 4)
        false = _make_detections(rng.uniform((60, 60), (750, 620), (2, 2)), radius=7.0, confidence=0.4)
        grid = arrange_in_grid(_join(_make_detections(moved[~gone]), false), SIZE)
        assert grid is not None
        off = np.linalg.norm(grid.center_px - moved, axis=-1)
        right += bool((grid.detected == ~gone).all() and (off[grid.detected] < 1e-6).all())
        mislabelled += bool((grid.detected & (off > 1)).sum() > 2)
    assert right >= tries * share
    assert mislabelled <= 1


HIDDEN = [[5], [5, 6, 9], [0, 5, 10, 15], [1, 5, 6, 9, 10], [0, 3, 4, 9, 10, 13, 6, 1]]


@pytest.mark.parametrize("hidden", list_cases(HIDDEN, [HIDDEN[0], HIDDEN[-1]]))
def test_hidden_markers_are_predicted_at_their_positions(hidden):
    gone = np.zeros(16, bool)
    gone[hidden] = True
    gone = gone.reshape(4, 4)
    true = project_points(MARKERS, make_view(SIZE, 8.0, 0.15))
    grid = detect_marker_grid(render_pattern(make_view(SIZE, 8.0, 0.15), hidden=gone))
    assert grid is not None
    np.testing.assert_array_equal(grid.detected, ~gone)
    assert np.isnan(grid.radius_px[gone]).all() and (grid.confidence[gone] == 0).all()
    assert np.linalg.norm(grid.center_px - true, axis=-1)[gone].max() < 5.0


def test_grid_of_a_grey_image_has_the_same_numbering():
    gone = np.zeros((4, 4), bool)
    gone[1, 2] = gone[3, 0] = True
    image = render_pattern(make_view((1224, 1024), -12.0, 0.1), (1224, 1024), hidden=gone)
    color, grey = detect_marker_grid(image), detect_marker_grid(compute_luminance(image))
    assert color is not None and grey is not None
    np.testing.assert_array_equal(color.detected, grey.detected)
    assert np.abs(color.center_px - grey.center_px).max() < 1.5


@pytest.mark.parametrize("turn", [90.0, 180.0, 270.0])
def test_grid_of_a_turned_camera_has_the_longer_steps_along_its_rows(turn):
    true = project_points(MARKERS, make_view(SIZE, turn))
    grid = arrange_in_grid(_make_detections(true), SIZE)
    assert grid is not None and grid.count == 16
    same = [np.abs(np.rot90(grid.center_px, k) - true).max() < 1e-9 for k in (0, 2)]  # up or upside down
    assert sum(same) == 1


def test_too_few_markers_form_no_grid():
    true = project_points(MARKERS, make_view(SIZE))
    assert arrange_in_grid(_make_detections(true[:2, :2]), SIZE) is None
    assert arrange_in_grid(_make_detections(np.empty((0, 2))), SIZE) is None


def test_numberings_contain_the_same_markers():
    true = project_points(MARKERS, make_view(SIZE))
    grid = arrange_in_grid(_make_detections(true[:3]), SIZE)  # the number of the missing row is unknown
    assert grid is not None
    options = grid.list_numberings()
    assert len(options) == 4 * 2
    for option in options:
        places = {tuple(p) for p in option.center_px[option.detected].round(6)}
        assert places == {tuple(p) for p in grid.center_px[grid.detected].round(6)}


@given(turn=st.floats(-20, 20), slant=st.floats(-0.2, 0.2))
def test_regions_divide_the_pattern_at_the_mean_between_markers(turn, slant):
    true = project_points(MARKERS, make_view(SIZE, turn, slant))
    grid = arrange_in_grid(_make_detections(true), SIZE)
    assert grid is not None
    outlines = [
        compute_region_outline(grid.center_px, *divmod(number, 4)).astype(np.float32) for number in range(16)
    ]

    def find_regions(point: np.ndarray) -> list[int]:
        contains = cv2.pointPolygonTest  # pyrefly: ignore[missing-attribute]
        return [i for i, each in enumerate(outlines) if contains(each, tuple(point), False) >= 0]

    for row in range(4):
        for column in range(3):
            a, b = true[row, column], true[row, column + 1]
            assert find_regions(a + 0.45 * (b - a)) == [4 * row + column]
            assert find_regions(a + 0.55 * (b - a)) == [4 * row + column + 1]
