"""Plausibility of registrations before the belt's motion is known."""

from __future__ import annotations

import pytest

from beltscape.measure.flow.plausibility import are_consistent, is_confirmed
from beltscape.measure.flow.registration import Shift


def make_shifts(*along_mm: float, support: float = 0.3) -> list[Shift]:
    return [Shift(along, 0.05, 0.0, 0.9, support=support) for along in along_mm]


@pytest.mark.parametrize("along_mm", [100.0, -100.0, 80.0])
def test_a_motion_as_long_as_the_encoders_step_is_confirmed(along_mm):
    assert is_confirmed(along_mm, 300.0, 200.0)


def test_a_chance_registration_of_another_length_is_not_confirmed():
    assert not is_confirmed(-190.0, 300.0, 200.0)


def test_an_encoder_of_another_scale_is_outvoted_by_equal_motions_of_much_material():
    assert not is_confirmed(100.0, 1300.0, 300.0)
    assert are_consistent(make_shifts(101.0, 100.0, 104.0))
    assert not are_consistent(make_shifts(101.0, -101.0, 100.0))
    assert not are_consistent(make_shifts(101.0, 100.0, 104.0, support=0.05))


def test_without_an_encoder_every_motion_counts():
    assert is_confirmed(55.0, None, None)
