"""Pictures of depth, error, reliability, views and confidence."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.report.drawing.depth_picture import (
    NO_TRUTH,
    draw_depth_map,
    make_confidence_panel,
    make_depth_panel,
    make_error_panel,
    make_reliability_panel,
    make_sigma_panel,
    make_views_panel,
)
from beltscape.report.drawing.legend import CERTAINTY, DIFFERENCE, QUIET, UNCERTAINTY
from beltscape.report.drawing.pictures import Panel

SIZE = (776, 200)
"""A map as wide as a panel's picture is drawn pixel by pixel."""
PALE = DIFFERENCE[128].astype(int)


def depth_map(z: np.ndarray, sigma_mm: float = 0.1) -> DepthMap:
    there = np.isfinite(z)
    sigma = np.where(there, np.float32(sigma_mm), np.float32(np.nan))
    views = np.where(there, np.arange(z.shape[1]) * 4 // z.shape[1] + 1, 0).astype(np.uint8)
    return DepthMap(z.astype(np.float32), sigma, views, (views / 4).astype(np.float32))


def flat() -> np.ndarray:
    return np.full(SIZE[::-1], 700.0)


def body(panel: Panel) -> np.ndarray:
    """The picture itself, between title and legend."""
    return panel.draw()[36 : 36 + SIZE[1], 12:-12].astype(int)


def test_an_error_has_its_colour_and_what_is_missing_too():
    z, truth = flat(), flat()
    z[10:20] += 0.5
    z[20:30] -= 0.5
    z[30:40] = np.nan
    truth[40:50] = np.nan
    picture = body(make_error_panel(depth_map(z), truth, limit_mm=0.5))
    for row, color in ((15, DIFFERENCE[-1]), (25, DIFFERENCE[0]), (35, QUIET), (45, NO_TRUTH), (60, PALE)):
        assert np.abs(picture[row] - color).max() <= 2, row
    halved = body(make_error_panel(depth_map(z), truth, limit_mm=1.0))
    assert np.abs(halved[15] - DIFFERENCE[191]).max() <= 2


def test_default_limit_resolves_typical_errors():
    noise = np.random.default_rng(0).normal(0, 0.03, SIZE[::-1])
    z = flat() + noise
    z[:3] += 50  # gross errors do not set the scale
    picture = body(make_error_panel(depth_map(z), flat()))
    assert (np.abs(picture[3:] - PALE).max(axis=-1) > 20).mean() > 0.5
    assert (picture[3:] == DIFFERENCE[[0, -1], None, None]).all(axis=-1).any(axis=0).mean() < 0.01


def test_reliability_picture_shows_the_error_in_sigma():
    z = flat()
    z[50:] += 0.4
    picture = body(make_reliability_panel(depth_map(z, 0.1), flat()))
    assert np.abs(picture[10] - PALE).max() <= 2
    assert np.abs(picture[60] - DIFFERENCE[-1]).max() <= 2


def test_another_grid_is_refused():
    with pytest.raises(InputError, match=r"the truth is \(3, 4\), the depth map \(200, 776\) pixels"):
        make_error_panel(depth_map(flat()), np.zeros((3, 4)))


def test_views_and_confidence_have_distinct_colours():
    z = flat()
    z[:20] = np.nan
    views, confidence = body(make_views_panel(depth_map(z))), body(make_confidence_panel(depth_map(z)))
    for quarter in range(4):
        u = 97 + 194 * quarter
        assert np.abs(views[100, u] - CERTAINTY[85 * quarter]).max() <= 1
        assert np.abs(confidence[100, u] - CERTAINTY[round(255 * (quarter + 1) / 4)]).max() <= 1
    for picture in (views, confidence):
        assert (picture[10] == QUIET).all()
    legend = make_views_panel(depth_map(z)).draw()[-38]
    for color in (*CERTAINTY[[0, 85, 170, 255]], QUIET):
        assert (legend == color).all(axis=1).sum() >= 16


def test_sigma_scale_is_logarithmic():
    sigma = np.geomspace(0.01, 1, SIZE[0], dtype=np.float32)[None].repeat(SIZE[1], axis=0)
    depth = depth_map(flat())
    picture = body(make_sigma_panel(DepthMap(depth.depth_mm, sigma, depth.views, depth.confidence)))
    for u in (50, 388, 700):  # even steps of the logarithm are even steps of colour
        assert np.abs(picture[100, u] - UNCERTAINTY[round(255 * u / 775)]).max() <= 8


def test_a_roof_is_lit_from_the_left():
    # near in the middle: its left side falls off to the left, its right side is as deep, but turned from the light
    u = np.arange(SIZE[0])
    picture = body(make_depth_panel(depth_map(flat() + 0.3 * np.abs(u - 388))))
    left, right = picture[100, 188].sum(), picture[100, 588].sum()
    assert left > 1.2 * right


@pytest.mark.parametrize("size", [(1, 1), (60, 40), (1700, 30)])
@pytest.mark.parametrize("kind", ["flat", "nothing", "one pixel"])
def test_any_map_can_be_shown(size, kind):
    z = np.full(size[::-1], 700.0 if kind == "flat" else np.nan)
    z[0, 0] = 700.0 if kind == "one pixel" else z[0, 0]
    depth = depth_map(z)
    assert draw_depth_map(depth).shape[1:] == (1600, 3)
    assert draw_depth_map(depth, z + 0.1).shape[1:] == (2400, 3)
    np.testing.assert_array_equal(draw_depth_map(depth), draw_depth_map(depth))
