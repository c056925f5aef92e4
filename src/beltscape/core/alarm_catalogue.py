"""The catalogue of alarms: one row for each kind of alarm and for each check of the system.

A row has the name of the alarm, the group of alarms with which it may share a cause, the estimates behind its
priority, and the states of the plant that explain it. Names, groups, priorities, suppression and settings of alarms
follow from the rows; the checks take their names from here. Within a group causes stand before their effects.

The texts of an alarm, by its name, are in the files of languages of the operator's page.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, TypedDict, get_args

from beltscape.core.alarms import Priority, Severity

Consequence = Literal["minor", "major", "severe"]
"""work or comfort; measured values lost or wrong; damage to the belt or an interruption of the plant"""
Response = Literal["slow", "soon", "prompt"]
"""more than 30 minutes; 5 to 30 minutes; less than 5 minutes until the consequence"""

MATRIX: Mapping[Consequence, Mapping[Response, Priority]] = {
    "minor": {"slow": "low", "soon": "low", "prompt": "medium"},
    "major": {"slow": "low", "soon": "medium", "prompt": "high"},
    "severe": {"slow": "medium", "soon": "high", "prompt": "urgent"},
}
"""Priority by consequence and time; most alarms come out low, as EEMUA 191 advises (about 80, 15 and 5 %)."""


@dataclass(frozen=True, slots=True)
class Rationale:
    """The estimates behind a default priority."""

    consequence: Consequence
    response: Response
    """Time until the consequence."""

    @property
    def priority(self) -> Priority:
        """Return the priority that follows from both."""
        return MATRIX[self.consequence][self.response]


FAULT = Rationale("major", "soon")
"""Of a check's fault: values are wrong or missing until it is repaired; the check itself marks the belt meanwhile."""

PlantState = Literal[
    "maintenance", "belt_stopped", "cameras_off", "frames_dropped", "encoder_silent", "encoder_wrong"
]
"""States of the plant that suppress alarms: each is itself an alarm or a check of the same name."""
STATES: tuple[PlantState, ...] = get_args(PlantState)


class FaultDefaults(TypedDict, total=False):
    """Settings of a check's alarm that differ from those of other faults."""

    severity: Severity
    after_s: float
    latched: bool


_NO_DEFAULTS = FaultDefaults()


@dataclass(frozen=True, slots=True)
class AlarmDefinition:
    """A row of the catalogue."""

    name: str
    group: str
    """Name of the group of alarms that one cause may raise together; empty: none."""
    rationale: Rationale
    """Chosen; every plant has its own."""
    suppressed_by: tuple[PlantState, ...]
    """States of the plant that explain it."""
    place: int | None
    """Place of a kind of alarm in the list of all, from 1; None for a check, whose alarms come behind."""
    fault_defaults: FaultDefaults
    """Settings of a check's alarm that differ from those of other faults."""


_TABLE: dict[str, AlarmDefinition] = {}


def _add(
    name: str,
    group: str = "",
    rationale: Rationale = FAULT,
    *explained_by: PlantState,
    place: int | None = None,
    in_maintenance: bool = False,
    fault_defaults: FaultDefaults = _NO_DEFAULTS,
) -> str:
    """Enter a row and return its name; only alarms ``in_maintenance`` do not depend on what the cameras see."""
    states: tuple[PlantState, ...] = explained_by if in_maintenance else ("maintenance", *explained_by)
    _TABLE[name] = AlarmDefinition(name, group, rationale, states, place, fault_defaults)
    return name


_LOW, _WORK, _LOST = Rationale("minor", "slow"), Rationale("minor", "soon"), Rationale("major", "prompt")
_DAMAGE, _URGENT = Rationale("severe", "soon"), Rationale("severe", "prompt")

# the group of the images
CAMERAS_OFF = _add("cameras_off", "images", _LOST, place=8)  # belt passes uncounted
CAMERA_LOST = _add("camera_lost", "images", FAULT, "cameras_off", place=9)  # the other cameras go on
LAMP = _add("lamp", "images", FAULT, "cameras_off")
PROJECTOR = _add("projector", "images", FAULT, "cameras_off")
LENS_COVERED = _add("lens_covered", "images", FAULT, "cameras_off")
SUNLIGHT = _add("sunlight", "images", FAULT, "cameras_off")
OVEREXPOSURE = _add("overexposure", "images", FAULT, "cameras_off")
EXPOSURE = _add("exposure", "images", FAULT, "cameras_off")
FLICKER = _add("flicker", "images", FAULT, "cameras_off", "frames_dropped")
CONDENSATION = _add("condensation", "images", _WORK)
DIRT = _add("dirt", "images", _WORK)
DUST = _add("dust", "images", _WORK, "cameras_off")
DEFOCUS = _add("defocus", "images")
PROJECTOR_FOCUS = _add("projector_focus", "images")
FROZEN_IMAGE = _add("frozen_image", "images", FAULT, "cameras_off", "frames_dropped")
# by the material's motion, and by the points that match
CAMERA_SYNC = _add("camera_sync", "images", FAULT, "cameras_off", "frames_dropped")
CAMERA_SKEW = _add("camera_skew", "images", FAULT, "cameras_off", "frames_dropped", place=10)
# the volume's uncertainty grows
LOW_COVERAGE = _add("low_coverage", "images", FAULT, "belt_stopped", "cameras_off", "frames_dropped", place=7)
# belt passes uncounted
NO_MEASUREMENT = _add(
    "no_measurement", "images", _LOST, "belt_stopped", "cameras_off", "frames_dropped", place=1
)

# the group of the motion
ENCODER_WRONG = _add("encoder_wrong", "motion", FAULT, place=18)
# the material's own motion is less certain
ENCODER_SILENT = _add("encoder_silent", "motion", FAULT, "frames_dropped", place=17)
ENCODER_MOTION = _add("encoder_motion", "motion", FAULT, "frames_dropped", "encoder_silent", "encoder_wrong")
THIN_OVERLAP = _add("thin_overlap", "motion")
BELT_STOPPED = _add("belt_stopped", "motion", _LOW, place=5)  # the control system knows it as well
EMPTY = _add("empty", "motion", _LOW, "belt_stopped", place=6)

# the group of the load
FOREIGN_OBJECT = _add("foreign_object", "load", _DAMAGE)  # a jammed lump blocks the transfer or cuts the belt
OVERSIZE_LUMP = _add("oversize_lump", "load", _URGENT, place=3)  # the next transfer blocks
OVERLOAD = _add("overload", "load", _URGENT, place=2)  # spillage, blocked transfer, overloaded drive
# the belt's edge wears on the structure
MISALIGNED_BELT = _add("misaligned_belt", "load", _DAMAGE, "belt_stopped", place=4)
TORN_EDGE_LEFT = _add("torn_edge_left", "load", _DAMAGE)  # a tear grows
TORN_EDGE_RIGHT = _add("torn_edge_right", "load", _DAMAGE)

# the group of the geometry
CAMERA_POSE = _add("camera_pose", "geometry")
CAMERA_POSE_UNCHECKED = _add(
    "camera_pose_unchecked",
    "geometry",
    _WORK,  # not known is not moved
    "frames_dropped",
    # no fault of the plant, so it waits as long as a camera without an image after the start
    fault_defaults={"severity": "info", "after_s": 30.0, "latched": False},
)
CAMERA_REDUNDANCY = _add("camera_redundancy", "geometry", _LOW)
PROJECTOR_MOVED = _add("projector_moved", "geometry")
TRAVEL_DIRECTION = _add("travel_direction", "geometry")
ZERO_SHIFT = _add("zero_shift", "geometry")
ZERO_TILT = _add("zero_tilt", "geometry")
ZERO_DRIFT = _add("zero_drift", "geometry")
CARRY_BACK = _add("carry_back", "geometry", _WORK)
CARRY_BACK_STUCK = _add("carry_back_stuck", "geometry", _WORK)
CARRY_BACK_TOTAL = _add("carry_back_total", "geometry", _LOW)

# the group of the computer
DISK_FULL = _add("disk_full", "computer", _LOST, place=12, in_maintenance=True)  # the reserve is finite
HISTORY_REPAIRED = _add("history_repaired", "computer", _LOW, place=13, in_maintenance=True)
RECORDING_PAUSED = _add("recording_paused", "computer", _LOW, place=16, in_maintenance=True)
# nobody can sign in
USERS_UNREADABLE = _add("users_unreadable", "computer", _WORK, place=14, in_maintenance=True)
# the shift's paper is missing
REPORTS_FAILING = _add("reports_failing", "computer", _WORK, place=15, in_maintenance=True)
# the processor takes over; where it is too slow, frames are dropped
GPU_LOST = _add("gpu_lost", "computer", _WORK, place=22, in_maintenance=True)
# the cause of what it hides; belt may pass uncounted
FRAMES_DROPPED = _add("frames_dropped", "computer", _LOST, place=11)

# of no group
CERTIFICATE_EXPIRING = _add("certificate_expiring", rationale=_LOW, place=19, in_maintenance=True)
MATERIAL_TEST_DUE = _add("material_test_due", rationale=_LOW, place=20, in_maintenance=True)
# a certificate does not say any more how far totals are off
TEST_CERTIFICATE_VOID = _add("test_certificate_void", rationale=_WORK, place=21, in_maintenance=True)
MAINTENANCE = _add("maintenance", rationale=_LOW)
SPLICE = _add("splice", rationale=_LOW)

DEFINITIONS: Mapping[str, AlarmDefinition] = MappingProxyType(_TABLE)
"""All rows by name."""
CHECKS = tuple(sorted(name for name, one in DEFINITIONS.items() if one.place is None))
"""Names of all checks in alphabetical order."""
KINDS = tuple(
    sorted((n for n, one in DEFINITIONS.items() if one.place), key=lambda n: DEFINITIONS[n].place or 0)
)
"""Kinds of the alarms that are not those of checks, in the order of display; each has settings and a rule."""
GROUPS: Mapping[str, tuple[str, ...]] = {
    group: tuple(name for name, one in DEFINITIONS.items() if one.group == group)
    for group in dict.fromkeys(one.group for one in DEFINITIONS.values() if one.group)
}
"""Alarms that one cause may raise together; in each group causes stand before their effects, which decides a tie."""


UNMEASURED = (NO_MEASUREMENT, LOW_COVERAGE)
"""What follows where the core camera is lost, or where a check's fault leaves nothing to measure."""


def list_suppressed(state: PlantState) -> tuple[str, ...]:
    """Return the names of the alarms that a state of the plant explains: kinds in their order, then checks."""
    return tuple(name for name in (*KINDS, *CHECKS) if state in DEFINITIONS[name].suppressed_by)


def split_name(name: str) -> tuple[str, str]:
    """Return kind and subject of an alarm's name: "camera_lost:cam2" has both, "overload" has no subject."""
    kind, _, subject = name.partition(":")
    return kind, subject


def list_keys(name: str) -> tuple[str, ...]:
    """Return the keys under which a table may have an alarm, the most specific first: its name, its kind."""
    kind = split_name(name)[0]
    return (name,) if kind == name else (name, kind)
