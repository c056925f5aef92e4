"""Alarms of the material test: due soon, overdue, and void because something that it applies to has changed."""

from __future__ import annotations

from dataclasses import replace

import pytest

from beltscape.core.events import CertificateReading
from tests.alarms.plant import GOOD, Plant


def list_states(reading: CertificateReading | None) -> dict[str, tuple[str, str]]:
    plant = Plant()
    plant.run(replace(GOOD, test_certificate=reading), 20)
    names = ("material_test_due", "test_certificate_void")
    return {one.name: (one.state, str(one.detail)) for one in plant.board.alarms if one.name in names}


def test_a_plant_without_a_certificate_has_no_such_alarm() -> None:
    assert {state for state, _ in list_states(None).values()} <= {"clear"}


@pytest.mark.parametrize(
    ("days", "state", "says"),
    [(15.0, "clear", ""), (13.0, "raised", "ends in 13.0 d"), (-3.2, "raised", "overdue by 3 days")],
)
def test_a_test_is_due_two_weeks_before_and_overdue_afterwards(days, state, says) -> None:
    found, detail = list_states(CertificateReading("2026-0001", days))["material_test_due"]
    assert found == state
    assert says in detail


@pytest.mark.parametrize("part", ["rig", "empty", "settings", "networks", "program"])
def test_a_change_of_what_it_applies_to_is_named(part) -> None:
    words = {"empty": "empty belt", "settings": "settings of measuring", "program": "program's version"}
    found, detail = list_states(CertificateReading("2026-0001", 99.0, (part,)))["test_certificate_void"]
    assert found == "raised"
    assert words.get(part, part) in detail.lower()
    assert "certificate 2026-0001" in detail
