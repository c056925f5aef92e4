"""A given direction or encoder is refused with the fix if the material contradicts it, and only then."""

from __future__ import annotations

from pathlib import Path

import pytest

from beltscape.core.errors import MeasureError
from beltscape.core.progress import Silent
from beltscape.measure.flow.meter import BeltFlowMeter
from beltscape.measure.flow.registration import Shift
from beltscape.measure.flow.settings import Direction, FlowSettings
from beltscape.pipeline.measuring.flow_checks import (
    describe_motion,
    require_consistent_motion,
    warn_of_motion_conflicts,
)
from tests.measure.flow.moving_belt import make_empty_belt

ENCODER = Path("encoder.csv")
STEP_MM = 200.0


def meter_with(
    given: Direction, along_mm: list[float], encoder_mm: list[float] | None, clear: bool = True
) -> BeltFlowMeter:
    """A meter that saw these motions of the material, beside these steps of an encoder."""
    meter = BeltFlowMeter(make_empty_belt(), FlowSettings(direction=given))
    steps = encoder_mm or [None] * len(along_mm)
    for along, step in zip(along_mm, steps, strict=True):
        meter.evidence.add(Shift(along, 0.05, 0.0, 0.9, clear), meter.direction, step)
    return meter


def refusal(meter: BeltFlowMeter, given: str | None, encoder: Path | None = ENCODER) -> str:
    with pytest.raises(MeasureError) as refused:
        require_consistent_motion(meter, given, encoder, done=True)
    assert "\n" not in str(refused.value)
    return str(refused.value)


@pytest.mark.parametrize("encoder", [None, [STEP_MM] * 7])
@pytest.mark.parametrize(("given", "way", "other"), [("-y", 1, "+y"), ("+y", -1, "-y")])
def test_direction_against_the_material_is_refused(
    encoder: list[float] | None, given: Direction, way: int, other: str
) -> None:
    meter = meter_with(given, [way * STEP_MM] * 7, encoder)
    text = refusal(meter, given, None if encoder is None else ENCODER)
    assert text.startswith(f"--direction {given}: the material moves towards {other} in 7 of 7 frame pairs")
    assert f"--direction {other}" in text


@pytest.mark.parametrize(
    ("factor", "name"), [(0.001, "metres"), (0.1, "centimetres"), (1000, "micrometres"), (1 / 25.4, "inches")]
)
def test_encoder_in_another_unit_is_refused_with_that_unit(factor: float, name: str) -> None:
    meter = meter_with("+y", [STEP_MM] * 5, [factor * STEP_MM] * 5)
    text = refusal(meter, "+y")
    assert text.startswith("encoder.csv: belt_position_mm grows by")
    assert name in text
    assert "5 of 5 frame pairs" in text


def test_encoder_that_stands_still_or_counts_on_is_refused() -> None:
    assert "the encoder stands still" in refusal(
        meter_with("+y", [STEP_MM] * 5, [0.0, 0.1, -0.1, 0, 0]), "+y"
    )
    assert "the material stands still" in refusal(meter_with("+y", [0.01] * 5, [STEP_MM] * 5), "+y")


@pytest.mark.parametrize("factor", [1.0, 0.9, 1.1, 0.998])
def test_sound_or_slipping_encoder_is_accepted(factor: float) -> None:
    meter = meter_with("+y", [STEP_MM] * 9, [factor * STEP_MM] * 9)
    require_consistent_motion(meter, "+y", ENCODER, done=True)
    reporter = Silent()
    warn_of_motion_conflicts(meter, ENCODER, reporter)
    assert not reporter.warnings


@pytest.mark.parametrize(
    ("by_encoder", "words"),
    [
        (0, "the material's motion was used"),
        (2, "the encoder's motion was used: there what the images show is no certain motion"),
        (1, "the material's motion was used in 1, the encoder's in 1"),
    ],
)
def test_a_conflict_names_whose_motion_was_used(by_encoder: int, words: str) -> None:
    meter = meter_with("+y", [STEP_MM] * 9, [STEP_MM] * 7 + [3 * STEP_MM] * 2)
    meter.evidence.by_encoder = by_encoder
    reporter = Silent()
    warn_of_motion_conflicts(meter, ENCODER, reporter)
    assert "in 2 of 9 frame pairs" in reporter.warnings[0]
    assert reporter.warnings[0].endswith(words) or f"{words}:" in reporter.warnings[0]


def test_empty_or_ambiguous_belt_contradicts_nothing() -> None:
    require_consistent_motion(meter_with("-y", [], None), "-y", None, done=True)
    require_consistent_motion(
        meter_with("-y", [STEP_MM] * 9, [STEP_MM] * 9, clear=False), "-y", ENCODER, done=True
    )
    require_consistent_motion(meter_with("-y", [STEP_MM] * 2, [STEP_MM] * 2), "-y", ENCODER, done=True)


def test_belt_that_rolls_back_at_first_is_accepted_before_the_end() -> None:
    meter = meter_with("+y", [-STEP_MM] * 4, None)
    require_consistent_motion(meter, "+y", None, done=False)
    for _ in range(9):
        meter.evidence.add(Shift(STEP_MM, 0.05, 0.0, 0.9), 1, None)
    require_consistent_motion(meter, "+y", None, done=True)
    reporter = Silent()
    warn_of_motion_conflicts(meter, None, reporter)
    assert "against +y in 4 of 13 frame pairs" in reporter.warnings[0]


def test_chance_registrations_beyond_the_encoder_step_are_ignored() -> None:
    meter = meter_with("+y", [], None)
    for along in (90.0, -300.0, 210.0, -50.0, 150.0):
        meter.evidence.add_apart(Shift(along, 0.05, 0.0, 0.5), 1, 2000.0)
    require_consistent_motion(meter, "+y", ENCODER, done=True)


def test_statement_names_the_evidence_of_the_direction() -> None:
    meter = meter_with("+y", [STEP_MM] * 5, None)
    assert describe_motion(meter, "+y") == (
        "towards +y as given and as the material moves in 5 of 5 frame pairs"
    )
    assert describe_motion(meter, None) == "towards +y: so the material moves in 5 of 5 frame pairs"
    assert "no frame pair shows it" in describe_motion(meter_with("+y", [], None), "+y")
    assert "unknown" in describe_motion(BeltFlowMeter(make_empty_belt(), FlowSettings()), None)
