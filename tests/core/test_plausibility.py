"""Plausibility of typed quantities: units are told apart by the values that quantities have."""

from __future__ import annotations

import math
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from beltscape.core import quantities
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.pose import Pose
from beltscape.core.progress import RecordingReporter, Silent
from beltscape.core.quantities import (
    BELT_WIDTH,
    DENSITY,
    LOAD_HEIGHT,
    UNITS,
    Quantity,
    find_unit,
    guess_unit_of_board,
    suggest_unit,
)
from beltscape.files.rig_json import read_rig
from beltscape.pipeline.calibrating.calibration import check_scale
from beltscape.target.board import Chessboard
from tests.synthetic.demo import TRUE_RIG

QUANTITIES = {name: each for name, each in vars(quantities).items() if isinstance(each, Quantity)}


@pytest.mark.parametrize("name", QUANTITIES)
def test_usual_values_are_possible_and_neither_is_remarked_on(name):
    quantity = QUANTITIES[name]
    (least, most), (low, high) = quantity.possible, quantity.usual
    assert least <= low < high <= most
    for value in (low, math.sqrt(low * high), high):
        assert quantity.find_refusal(value) == quantity.find_oddity(value) == ""
    for value in (-1.0, math.nan, math.inf, 2 * most):
        assert quantity.find_refusal(value)
    assert bool(quantity.find_refusal(0.0)) == (least > 0 and not quantity.is_zero_possible)
    assert quantity.unit in UNITS or quantity.unit == "per_s"


@pytest.mark.parametrize(
    ("quantity", "value", "text"),
    [
        (LOAD_HEIGHT, 0.2, "cannot be the height of a load in mm (2 to 5000); in metres? write 200"),
        (
            LOAD_HEIGHT,
            8,
            "is unusual for the height of a load in mm (20 to 1500); in centimetres? write 80; in inches?",
        ),
        (DENSITY, 1.6, "cannot be a bulk density in kg/m³ (5 to 30000); in t/m³? write 1600"),
        (BELT_WIDTH, 1.2, "cannot be a width of belt in mm (20 to 20000); in metres? write 1200"),
        (BELT_WIDTH, 80, "in centimetres? write 800; in inches? write 2032"),
        (BELT_WIDTH, 1e6, "cannot be a width of belt in mm (20 to 20000); in micrometres? write 1000"),
    ],
)
def test_a_wrong_value_is_named_with_its_unit_and_what_to_write(quantity, value, text):
    assert text in (quantity.find_refusal(value) or quantity.find_oddity(value))


@pytest.mark.parametrize(
    ("key", "unit"),
    [
        ("speed_mm_s", "mm_s"),
        ("speed_m_s", "m_s"),
        ("load_mm", "mm"),
        ("belt_m", "m"),
        ("area_mm2", "mm2"),
        ("a", ""),
    ],
)
def test_the_unit_is_at_the_end_of_a_name(key, unit):
    assert find_unit(key) == unit


def test_no_unit_is_suggested_where_none_fits():
    assert suggest_unit(-3, "mm", lambda value: value > 0) == ""
    assert suggest_unit(3, "apples", lambda _: True) == ""


RIGS = list(product((12.0, 30.0, 60.0), (450.0, 900.0, 2000.0), (120.0, 300.0, 700.0)))
WRITTEN_IN = {"mm": 1.0, **dict(UNITS["mm"])}


@pytest.mark.parametrize("unit", WRITTEN_IN)
def test_the_rig_that_a_board_makes_shows_its_unit(unit):
    """Rigs whose parts are all small or all large are like others in the next unit: then the right one is second."""
    factor, first = WRITTEN_IN[unit], 0
    for square, distance, baseline in RIGS:
        units = [
            name for name, _ in guess_unit_of_board(square / factor, distance / factor, baseline / factor)
        ]
        if unit == "mm":
            assert units == []
        else:
            first += units[0] == unit
            assert unit in units
    if unit != "mm":
        assert first >= 0.8 * len(RIGS)


@pytest.mark.parametrize(("factor", "guess"), [(1e-3, "metres (30 mm)"), (1e3, "micrometres (30 mm)")])
def test_a_board_in_another_unit_makes_no_rig_that_cannot_be_read(factor, guess):
    rig = read_rig(TRUE_RIG)
    poses = {name: Pose(p.rotation, factor * p.translation_mm) for name, p in rig.cam_from_core.items()}
    scaled: Any = SimpleNamespace(
        cameras=rig.cameras, core=rig.core, auxiliaries=rig.auxiliaries, cam_from_core=poses
    )
    board: Any = SimpleNamespace(square_mm=30 * factor)
    geometry: Any = SimpleNamespace(board_translation_mm=np.array([[0.0, 0.0, 700.0 * factor]]))
    adjusted: Any = SimpleNamespace(geometry=geometry)
    with pytest.raises(CalibrationError, match="was it given in") as caught:
        check_scale(board, adjusted, scaled, Silent())
    assert guess in str(caught.value)


def test_a_rig_in_mm_is_not_remarked_on():
    reporter = RecordingReporter(Silent())
    adjustment: Any = SimpleNamespace(
        geometry=SimpleNamespace(board_translation_mm=np.array([[0.0, 0.0, 700.0]]))
    )
    check_scale(
        Chessboard(corners=(8, 5), square_mm=34),
        adjustment,
        read_rig(TRUE_RIG),
        reporter,
    )
    assert reporter.warnings == []
