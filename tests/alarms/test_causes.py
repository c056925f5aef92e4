"""An alarm names the cause: what follows from it is silent while it stands, and named beside it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import pytest

from beltscape.alarms.settings import AlarmSettings, SuppressionSettings
from beltscape.core.alarm_catalogue import (
    CHECKS,
    DEFINITIONS,
    KINDS,
    STATES,
    UNMEASURED,
    list_suppressed,
    split_name,
)
from beltscape.core.alarms import Suppression
from beltscape.core.findings import Finding
from tests.alarms.plant import BAD, GOOD, NAN, Plant, camera

CORE = "cam0"
CAMERAS = {name: camera(name) for name in (CORE, "cam2", "cam3")}
SOUND = replace(GOOD, cameras=CAMERAS, core=CORE)
UNLOADED: dict[str, Any] = {"area_mm2": NAN, "volume_flow_m3_h": NAN, "mass_flow_t_h": NAN}
NOTHING_MEASURED: dict[str, Any] = {**UNLOADED, "coverage": 0.0}
FOLLOWS_NOTHING_MEASURED = {"no_measurement:load", "low_coverage"}


def fault(check: str, effect: Any = "degraded", subject: str = "") -> Finding:
    return Finding(check, 9.0, 0.1, 1.0, "", subject, f"{check} is not as it was", effect)


@dataclass(frozen=True)
class Cause:
    """What a cause changes in the readings, with all that can follow from it."""

    alarm: str
    changes: dict[str, Any]
    silent: set[str]
    """The alarms that must be silent."""
    others: frozenset[str] = frozenset()
    """Other alarms of these readings, which the cause does not explain."""

    def __str__(self) -> str:
        return self.alarm


LOST = {name: camera(name, state="lost", message="silent") for name in CAMERAS}
OF_IMAGES = [fault(name) for name in ("camera_sync", "frozen_image", "flicker", "encoder_motion")]
OF_ALL_OFF = [name for name in list_suppressed("cameras_off") if name in CHECKS]
BLIND = (
    "projector",
    "exposure",
    "lens_covered",
    "overexposure",
    "frozen_image",
    "camera_pose",
    "camera_sync",
)
"""Checks whose faults can leave nothing to measure."""

CAUSES = [
    Cause(
        "frames_dropped",
        {
            **NOTHING_MEASURED,
            "dropped_per_minute": 90.0,
            "encoder_silent_s": 4.0,
            "cameras": CAMERAS | {"cam2": camera(skew_ms=-5.0)},
            "findings": [*OF_IMAGES, fault("camera_pose_unchecked"), fault("dirt")],
        },
        {*FOLLOWS_NOTHING_MEASURED, "encoder_silent", "encoder_motion", "camera_skew", "camera_sync",
         "frozen_image", "flicker", "camera_pose_unchecked"},
        frozenset({"dirt"}),
    ),
    Cause(
        "cameras_off",
        {
            **NOTHING_MEASURED,
            "cameras": LOST,
            "findings": [*(fault(name, subject="cam2") for name in OF_ALL_OFF), fault("encoder_motion")],
        },
        {*FOLLOWS_NOTHING_MEASURED, *(f"camera_lost:{name}" for name in LOST),
         *(f"{name}:cam2" for name in OF_ALL_OFF)},
        frozenset({"encoder_motion"}),
    ),
    Cause(
        "belt_stopped",
        {**UNLOADED, "speed_mm_s": 0.0, "coverage": 0.4, "belt_offset_mm": -70.0},
        {*FOLLOWS_NOTHING_MEASURED, "misaligned_belt"},
    ),
    Cause(
        f"camera_lost:{CORE}",
        {**NOTHING_MEASURED, "cameras": CAMERAS | {CORE: LOST[CORE]}},
        FOLLOWS_NOTHING_MEASURED,
    ),
    Cause("encoder_silent", {"encoder_silent_s": 9.0, "findings": [fault("encoder_motion")]}, {"encoder_motion"}),
    Cause(
        "encoder_wrong", {"encoder_trouble": "runs backwards", "findings": [fault("encoder_motion")]},
        {"encoder_motion"},
    ),
    *(
        Cause(check, {**NOTHING_MEASURED, "findings": [fault(check, "missing")]}, FOLLOWS_NOTHING_MEASURED)
        for check in BLIND
    ),
]  # fmt: skip


@pytest.mark.parametrize("cause", CAUSES, ids=str)
def test_what_follows_from_a_cause_is_silent_while_it_stands_and_named_beside_it(cause: Cause) -> None:
    plant = Plant()
    plant.run(SOUND, 5)
    changed = plant.run(replace(SOUND, **cause.changes), 200)
    listed = {name for name, state in plant.states().items() if state != "clear"}
    assert listed == {cause.alarm, *cause.others}
    (alarm,) = (one for one in plant.board.alarms if one.name == cause.alarm)
    assert alarm.detail
    assert set(alarm.consequences) == cause.silent
    assert "no_measurement:load" not in {one.name for one in changed if one.state == "raised"}
    passed = [replace(one, value=0.1, text="") for one in cause.changes.get("findings", ())]
    after = plant.run(replace(SOUND, findings=passed), 60)
    came_before = {one.name for one in changed if one.state == "raised"}  # the cause's own delay
    assert {one.name for one in after if one.state == "raised"} <= came_before


@pytest.mark.parametrize("cause", CAUSES, ids=str)
def test_without_the_cause_its_consequences_are_alarms(cause: Cause) -> None:
    """So that the silence is that of the cause, and not of readings that raise nothing."""
    plant = Plant(AlarmSettings(suppression=SuppressionSettings(
        **dict.fromkeys((*STATES, "unmeasured"), ()))))  # fmt: skip
    plant.run(SOUND, 5)
    plant.run(replace(SOUND, **cause.changes), 200)
    raised = {name for name, state in plant.states().items() if state == "raised"}
    assert raised == {cause.alarm, *cause.silent, *cause.others}


def test_the_table_has_every_cause_and_every_consequence() -> None:
    """Maintenance has its own test. "empty" needs a known load, which a stopped belt has no more, and silent cameras
    have no skew but one from before.
    """
    without = {"belt_stopped": {"empty"}, "cameras_off": {"camera_skew"}}
    silent = {split_name(cause.alarm)[0]: cause.silent for cause in CAUSES}
    for state in set(STATES) - {"maintenance"}:
        assert {split_name(name)[0] for name in silent[state]} == set(list_suppressed(state)) - without.get(
            state, set()
        )
    assert set(BLIND) <= set(CHECKS)
    assert set(UNMEASURED) <= set(KINDS)
    assert all(DEFINITIONS[name].group for name in silent)


@pytest.mark.parametrize("is_shelved", [True, False])
def test_a_cause_that_people_have_hidden_explains_nothing(is_shelved: bool) -> None:
    kind = "shelved" if is_shelved else "out_of_service"
    plant = Plant()
    plant.run(SOUND, 5)
    plant.board.hide({f"camera_lost:{CORE}": Suppression(kind, "being repaired", "ada", 1, 2)})
    plant.run(replace(SOUND, **NOTHING_MEASURED, cameras=CAMERAS | {CORE: LOST[CORE]}), 60)
    assert plant.states()["no_measurement:load"] == "raised"


def test_an_auxiliary_that_is_lost_explains_no_missing_load() -> None:
    plant = Plant()
    plant.run(SOUND, 5)
    plant.run(replace(SOUND, **NOTHING_MEASURED, cameras=CAMERAS | {"cam2": LOST["cam2"]}), 60)
    assert plant.states()["no_measurement:load"] == plant.states()["camera_lost:cam2"] == "raised"


def test_the_cause_is_as_urgent_as_what_it_hides() -> None:
    plant = Plant()
    plant.run(SOUND, 5)
    plant.run(replace(SOUND, **BAD["no_measurement:load"]), 60)
    (load,) = (one for one in plant.board.alarms if one.name == "no_measurement:load")
    plant = Plant()
    plant.run(SOUND, 5)
    plant.run(replace(SOUND, **NOTHING_MEASURED, cameras=CAMERAS | {CORE: LOST[CORE]}), 60)
    (lost,) = (one for one in plant.board.alarms if one.name == f"camera_lost:{CORE}")
    assert (lost.priority, lost.severity) == (load.priority, load.severity) == ("high", "critical")
