"""Priorities: defaults from consequence and time, and the plant's own."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest

from beltscape.alarms.management import select_priority
from beltscape.alarms.settings import AlarmSettings
from beltscape.core.alarm_catalogue import DEFINITIONS, MATRIX, Consequence, Response
from beltscape.core.alarms import PRIORITIES
from tests.alarms.plant import BAD, GOOD, Plant

TIMES: tuple[Response, ...] = ("slow", "soon", "prompt")
CONSEQUENCES: tuple[Consequence, ...] = ("minor", "major", "severe")


def test_the_matrix_grows_with_consequence_and_haste():
    rows = [[PRIORITIES.index(MATRIX[what][when]) for when in TIMES] for what in CONSEQUENCES]
    assert all(a <= b for row in rows for a, b in pairwise(row))
    assert all(a <= b for one, two in pairwise(rows) for a, b in zip(one, two, strict=True))


def test_few_alarms_are_high_and_hardly_any_urgent():
    counts = dict.fromkeys(PRIORITIES, 0)
    for definition in DEFINITIONS.values():
        counts[definition.rationale.priority] += 1
    assert counts["urgent"] <= counts["high"] <= counts["medium"]
    assert counts["urgent"] <= 0.05 * sum(counts.values())


@pytest.mark.parametrize(
    ("chosen", "expected"),
    [
        ({}, "medium"),
        ({"camera_lost": "low"}, "low"),
        ({"camera_lost": "low", "camera_lost:cam2": "urgent"}, "urgent"),
    ],
)
def test_the_plant_s_own_priority_stands_before_the_default(chosen, expected):
    assert select_priority("camera_lost:cam2", chosen) == expected
    plant = Plant(AlarmSettings.model_validate({"priorities": chosen}))
    plant.run(GOOD, 5)
    (alarm,) = plant.run(replace(GOOD, **BAD["camera_lost:cam2"]), 3)
    assert alarm.priority == expected


def test_a_priority_that_does_not_exist_is_refused():
    with pytest.raises(ValueError, match="'low', 'medium', 'high' or 'urgent'"):
        AlarmSettings.model_validate({"priorities": {"overload": "huge"}})
