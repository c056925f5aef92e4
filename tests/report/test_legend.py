"""Colour scales and legends."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from warnings import catch_warnings, simplefilter

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.report.drawing.legend import (
    CERTAINTY,
    DIFFERENCE,
    LEGEND_PX,
    PAPER,
    QUIET,
    UNCERTAINTY,
    Scale,
    Swatches,
    draw_scale_with_key,
    draw_text,
    round_above,
    round_below,
)
from beltscape.report.drawing.plots import WIDE, make_panels, to_png

SCALES = [
    Scale(611.3, 742.8, UNCERTAINTY),
    Scale(-0.5, 0.5, DIFFERENCE),
    Scale(0.0, 1.0, CERTAINTY),
    Scale(0.02, 2.0, UNCERTAINTY, log=True),
    Scale(0.001, 5000.0, UNCERTAINTY, log=True),
]
RAMP_ROW = 12


@given(st.floats(1e-6, 1e6))
def test_round_values_enclose(value):
    above, below = round_above(value), round_below(value)
    assert below * (1 - 1e-6) <= value <= above * (1 + 1e-6)
    assert above / value < 2.5 + 1e-6 and value / below < 2.5 + 1e-6
    for found in (above, below):
        assert float(f"{found:e}".split("e")[0]) in (1, 2, 5)


@pytest.mark.parametrize("scale", SCALES)
def test_the_ramp_has_at_each_tick_the_colour_of_its_value(scale):
    ticks = np.array(scale.ticks())
    assert 3 <= len(ticks) <= 12
    assert (ticks >= scale.low * (1 - 1e-3)).all() and (ticks <= scale.high * (1 + 1e-3)).all()
    legend = scale.legend(700)
    assert legend.shape == (LEGEND_PX, 700, 3)
    below = legend[RAMP_ROW + 11]  # the ticks' own row, under the ramp
    drawn = np.flatnonzero((below == QUIET).all(axis=1))
    for tick, color in zip(ticks, scale.to_rgb(ticks), strict=True):
        ramp = legend[RAMP_ROW, drawn].astype(int)
        assert np.abs(ramp - color).max(axis=1).min() <= 6, tick
    assert len(drawn) >= len(ticks)


@pytest.mark.parametrize("scale", SCALES)
def test_colours_run_from_end_to_end_and_stay_there(scale):
    middle = np.sqrt(scale.low * scale.high) if scale.log else (scale.low + scale.high) / 2
    values = np.array([scale.low, middle, scale.high, scale.high * 3, np.nan])
    colors = scale.to_rgb(values)
    np.testing.assert_array_equal(colors[0], scale.colormap[0])
    assert np.abs(colors[1].astype(int) - scale.colormap[127:129].mean(axis=0)).max() < 3
    np.testing.assert_array_equal(colors[2:4], [scale.colormap[-1]] * 2)
    np.testing.assert_array_equal(colors[4], QUIET)


def test_what_has_no_logarithm_has_an_end_or_no_colour():
    scale = Scale(0.1, 10.0, UNCERTAINTY, log=True)
    np.testing.assert_array_equal(scale.to_rgb(np.array([0.0, -1.0])), [UNCERTAINTY[0], QUIET])


def test_zero_is_no_negative_number():
    assert [str(tick) for tick in Scale(-1.0, 1.0, DIFFERENCE).ticks()] == [
        "-1.0",
        "-0.5",
        "0.0",
        "0.5",
        "1.0",
    ]


def test_a_key_shows_its_colours_beside_the_scale():
    key = Swatches([("not measured", QUIET), ("no truth", (0, 0, 0))])
    foot = draw_scale_with_key(SCALES[1], key, 776)
    assert foot.shape == (LEGEND_PX, 776, 3)
    row = foot[RAMP_ROW]
    for _, color in key.entries:
        assert ((row == color).all(axis=1)).sum() >= 16
    np.testing.assert_array_equal(row[-2:], [PAPER] * 2)  # nothing is cut off
    np.testing.assert_array_equal(row[0], DIFFERENCE[0])


def test_texts_of_two_threads_do_not_take_each_others_size():
    def draw(size):
        images = set()
        for _ in range(300):
            image = np.full((60, 300, 3), PAPER, np.uint8)
            draw_text(image, "depth, mm", (5, 45), size)
            images.add(image.tobytes())
        return len(images)

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(draw, (13, 40))) == [1, 1]


def test_names_in_other_scripts_are_drawn_without_warnings():
    def draw(name: str) -> np.ndarray:
        figure, (axis,) = make_panels(1, WIDE)
        axis.set_title(name)
        picture = cv2.imdecode(np.frombuffer(to_png(figure), np.uint8), 0)
        assert picture is not None
        return picture[: len(picture) // 5]

    with catch_warnings():
        simplefilter("error")
        pictures = {
            name: draw(name) for name in ("", "相机3", "机相3", "カメラ", "카메라", "камера", "cam $x$ 3")
        }
    assert all((picture < 128).sum() > 40 for name, picture in pictures.items() if name)
    # boxes in place of the characters would look alike
    assert not np.array_equal(pictures["相机3"], pictures["机相3"])
    assert not np.array_equal(pictures["カメラ"], pictures["카메라"])
