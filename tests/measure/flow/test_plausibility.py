"""Plausibility of registrations before the belt's motion is known."""

from __future__ import annotations

import math

import pytest

from beltscape.measure.flow.motion.plausibility import is_confirmed

NONE = float("nan")


@pytest.mark.parametrize("along_mm", [100.0, -100.0, 80.0])
def test_a_motion_as_long_as_the_encoders_step_is_confirmed(along_mm):
    assert is_confirmed(along_mm, 300.0, 200.0, NONE)


def test_a_chance_registration_of_another_length_is_not_confirmed():
    assert not is_confirmed(-190.0, 300.0, 200.0, NONE)


def test_an_encoder_of_another_scale_is_outvoted_by_two_equal_motions():
    assert not is_confirmed(100.0, 1300.0, 300.0, NONE)
    assert is_confirmed(101.0, 2300.0, 1300.0, 100.0)
    assert not is_confirmed(-101.0, 2300.0, 1300.0, 100.0)


def test_without_an_encoder_every_motion_counts():
    assert is_confirmed(55.0, None, None, math.nan)
