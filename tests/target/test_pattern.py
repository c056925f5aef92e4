"""The speckle pattern: dots, markers and blue noise."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial import KDTree

from beltscape.core.errors import SettingsError
from beltscape.target.blue_noise import measure_blue_noise
from beltscape.target.pattern import Pattern, PatternSettings, make_pattern, resolve_settings
from beltscape.target.pattern_formats import draw_pattern
from tests.optional import require

SMALL: dict[str, Any] = {"size_px": (640, 400), "count": 2000}


@pytest.fixture(scope="module")
def paper() -> Pattern:
    return make_pattern(PatternSettings())


def test_paper_pattern_has_25000_dots_with_their_minimum_distance(paper):
    assert paper.dots.shape == (25_000, 4)
    nearest = KDTree(paper.dots[:, :2]).query(paper.dots[:, :2], k=2)[0][:, 1]
    assert paper.settings.d_min_px == 7.75
    assert nearest.min() > paper.settings.d_min_px
    assert (paper.dots[:, 3] == 1).all()


def test_markers_are_at_the_centres_of_blocks_and_ten_times_larger(paper):
    got = [(m.row, m.col, *m.center_px) for m in paper.markers]
    assert got == [
        (row, col, 1920 / 4 * (col + 0.5) - 0.5, 1200 / 4 * (row + 0.5) - 0.5)
        for row in range(4)
        for col in range(4)
    ]
    assert {m.radius_px for m in paper.markers} == {26.4} == {round(10 * paper.dots[0, 2], 6)}


def test_dots_are_as_far_from_markers_as_from_dots(paper):
    settings, centers = paper.settings, np.array([m.center_px for m in paper.markers])
    gap = np.linalg.norm(paper.dots[:, None, :2] - centers, axis=2) - paper.markers[0].radius_px
    between = settings.d_min_px - settings.radius_px
    assert between < gap.min() < between + 1


def test_pattern_is_blue_noise(paper):
    quality = measure_blue_noise(paper)
    assert quality.low_frequency_power < 0.1
    assert quality.peak_power > 1.5
    assert quality.peak_frequency_per_px * quality.d_min_px == pytest.approx(0.925)
    assert quality.nearest_min_px > quality.d_min_px
    assert quality.nearest_share.sum() == pytest.approx(1)
    assert 0.74 < quality.relative_radius < 0.78


def test_independent_dots_differ_from_blue_noise(paper):
    rng = np.random.default_rng(0)
    dots = np.column_stack([rng.random((25_000, 2)) * (1920, 1200) - 0.5, paper.dots[:, 2:]])
    away = np.ones(len(dots), dtype=bool)
    for x, y, radius in paper.keep_out():
        away &= np.hypot(dots[:, 0] - x, dots[:, 1] - y) > radius
    quality = measure_blue_noise(Pattern(paper.settings, dots[away], paper.markers))
    np.testing.assert_allclose(quality.power[2:], 1, atol=0.12)
    assert quality.low_frequency_power == pytest.approx(1, abs=0.05)
    assert quality.relative_radius < 0.1


def test_positions_depend_on_the_seed_and_not_on_the_grey_range():
    one, again = (make_pattern(PatternSettings(**SMALL, seed=1)) for _ in range(2))
    grey = make_pattern(PatternSettings(**SMALL, seed=1, grey=(0.25, 0.75)))
    other = make_pattern(PatternSettings(**SMALL, seed=2))
    assert one.dots.tobytes() == again.dots.tobytes()
    np.testing.assert_array_equal(one.dots[:, :3], grey.dots[:, :3])
    assert grey.dots[:, 3].min() >= 0.25 and grey.dots[:, 3].max() <= 0.75
    assert np.ptp(grey.dots[:, 3]) > 0.45
    assert not np.array_equal(one.dots, other.dots)


def refusal(**changed):
    with pytest.raises(SettingsError) as error:
        make_pattern(PatternSettings(**{**SMALL, **changed}))
    return str(error.value)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"d_min_px": 12}, "2000 dots do not fit 640×400 px at d_min 12 px; at most "),
        (
            {"d_min_px": 4, "radius_px": 2.3},
            "d_min 4 px lets dots of radius 2.3 px overlap; give d_min of at least 4.6 px, or a radius up to 2 px",
        ),
        (
            {"count": 9000, "radius_px": 2.4},
            "9000 dots of radius 2.4 px overlap on 640×400 px; give at most ",
        ),
        (
            {"radius_px": 3},
            "dots of radius 3 px have markers of 30 px, too large for their blocks on 640×400 px; "
            "give a dot radius up to 2.5 px",
        ),
        (
            {"count": 400_000},
            "400000 dots on 640×400 px would be finer than a radius of 0.3 px; give at most ",
        ),
    ],
)
def test_settings_that_do_not_fit_are_refused_in_one_line(changed, message):
    text = refusal(**changed)
    assert text.startswith(message)
    assert "\n" not in text


def test_every_fix_proposed_by_a_refusal_works():
    too_close = refusal(d_min_px=12)
    most, largest = require(re.search(r"at most (\d+) do, or d_min up to ([\d.]+) px", too_close)).groups()
    assert len(make_pattern(PatternSettings(**(SMALL | {"count": int(most)}), d_min_px=12)).dots) == int(most)
    assert len(make_pattern(PatternSettings(**SMALL, d_min_px=float(largest))).dots) == 2000
    assert "do not fit" in refusal(d_min_px=float(largest) + 0.01)

    too_wide = refusal(radius_px=2.4, count=9000)
    most = int(require(re.search(r"give at most (\d+) dots", too_wide))[1])
    resolve_settings(PatternSettings(**(SMALL | {"count": most}), radius_px=2.4))
    assert "overlap" in refusal(radius_px=2.4, count=most + 30)

    too_fine = refusal(count=400_000)
    most = int(require(re.search(r"at most (\d+)", too_fine))[1])
    resolve_settings(PatternSettings(**(SMALL | {"count": most})))

    too_large = refusal(radius_px=3)
    widest = float(require(re.search(r"radius up to ([\d.]+)", too_large))[1])
    resolve_settings(PatternSettings(**(SMALL | {"count": 500}), radius_px=widest))


@pytest.mark.parametrize(
    "changed",
    [{"dot_color": "gold"}, {"grey": (0.5, 0.2)}, {"grey": (0, 2)}, {"count": 0}, {"size_px": (9, 9)}],
)
def test_settings_out_of_bounds_are_refused(changed):
    with pytest.raises(ValidationError):
        PatternSettings(**changed)


@pytest.mark.parametrize(("bits", "top"), [(8, 255), (16, 65535)])
def test_image_has_the_colours_at_their_positions(bits, top):
    colors: dict[str, Any] = {"dot_color": "#FFFFFF", "background": "#000000", "marker_color": "#ff0000"}
    pattern = make_pattern(PatternSettings(**SMALL, **colors, grey=(0.5, 1)))
    image = draw_pattern(pattern, bits)
    assert image.shape == (400, 640, 3)
    assert image.dtype == (np.uint8 if bits == 8 else np.uint16)
    row, col = (round(c) for c in pattern.markers[5].center_px[::-1])
    assert image[row, col].tolist() == [top, 0, 0]
    blue = image[..., 2].astype(float) / top  # dots only
    inner = (np.abs(pattern.dots[:, :2] - (319.5, 199.5)) < (310, 190)).all(axis=1)
    rows, cols = np.indices(blue.shape)
    for x, y, radius, level in pattern.dots[inner][:40]:
        own = np.hypot(cols - x, rows - y) < radius + 0.71  # its pixels, and none of its neighbours'
        assert blue[own].sum() == pytest.approx(level * np.pi * radius**2, abs=1e-3 if bits == 16 else 0.1)


def test_dot_in_16_bits_has_its_area_to_a_thousandth():
    colors: dict[str, Any] = {"dot_color": "#FFFFFF", "background": "#000000", "marker_color": "#000000"}
    pattern = make_pattern(PatternSettings(size_px=(640, 400), count=1, **colors, seed=3))
    x, y, radius, _ = pattern.dots[0]
    assert radius < x < 639 - radius and radius < y < 399 - radius
    area = draw_pattern(pattern, 16)[..., 0].sum() / 65535
    assert area == pytest.approx(np.pi * radius**2, abs=1e-3)


def test_markers_of_few_dots_do_not_fill_their_blocks():
    settings = resolve_settings(PatternSettings(count=10))
    assert 2 * 10 * require(settings.radius_px) <= 1200 / 4 / 2
