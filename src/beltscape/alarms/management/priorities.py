"""The priority of every alarm, from the consequence of not acting and the time in which to act.

The default of an alarm follows from two estimates, as the rationalization of ANSI/ISA-18.2 and EEMUA 191 asks for:
what happens if nobody acts, and how soon it happens. A plant whose estimates differ sets the priority itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from beltscape.alarms.names import list_keys, split_name
from beltscape.core.live.alarms import Priority

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


_FAULT = Rationale("major", "soon")
"""Of a check's fault: values are wrong or missing until it is repaired; the check itself marks the belt meanwhile."""
RATIONALES: Mapping[str, Rationale] = {
    "no_measurement": Rationale("major", "prompt"),  # belt passes uncounted
    "overload": Rationale("severe", "prompt"),  # spillage, blocked transfer, overloaded drive
    "oversize_lump": Rationale("severe", "prompt"),  # the next transfer blocks
    "misaligned_belt": Rationale("severe", "soon"),  # the belt's edge wears on the structure
    "belt_stopped": Rationale("minor", "slow"),  # the control system knows it as well
    "empty": Rationale("minor", "slow"),
    "low_coverage": Rationale("major", "soon"),  # the volume's uncertainty grows
    "cameras_off": Rationale("major", "prompt"),  # belt passes uncounted
    "camera_lost": Rationale("major", "soon"),  # the other cameras go on
    "camera_skew": Rationale("major", "soon"),
    "frames_dropped": Rationale("major", "prompt"),  # the cause of what it hides; belt may pass uncounted
    "disk_full": Rationale("major", "prompt"),  # the reserve is finite
    "history_repaired": Rationale("minor", "slow"),
    "users_unreadable": Rationale("minor", "soon"),  # nobody can sign in
    "reports_failing": Rationale("minor", "soon"),  # the shift's paper is missing
    "recording_paused": Rationale("minor", "slow"),
    "encoder_silent": Rationale("major", "soon"),  # the material's own motion is less certain
    "encoder_wrong": Rationale("major", "soon"),
    "certificate_expiring": Rationale("minor", "slow"),
    "torn_edge_left": Rationale("severe", "soon"),  # a tear grows
    "torn_edge_right": Rationale("severe", "soon"),
    "camera_pose_unchecked": Rationale("minor", "soon"),  # nothing is known to be wrong
    "camera_redundancy": Rationale("minor", "slow"),
    "carry_back": Rationale("minor", "soon"),
    "carry_back_stuck": Rationale("minor", "soon"),
    "carry_back_total": Rationale("minor", "slow"),
    "condensation": Rationale("minor", "soon"),
    "dirt": Rationale("minor", "soon"),
    "dust": Rationale("minor", "soon"),
    "maintenance": Rationale("minor", "slow"),
    "splice": Rationale("minor", "slow"),
    "foreign_object": Rationale("severe", "soon"),  # a jammed lump blocks the transfer or cuts the belt
}
"""By kind of alarm; checks that are not named have the estimates of a fault. Chosen; every plant has its own."""


def get_rationale(name: str) -> Rationale:
    """Return the estimates for an alarm."""
    return RATIONALES.get(split_name(name)[0], _FAULT)


def select_priority(name: str, chosen: Mapping[str, Priority]) -> Priority:
    """Return the priority of an alarm: the plant's choice for its name or its kind, else the default."""
    for key in list_keys(name):
        if key in chosen:
            return chosen[key]
    return get_rationale(name).priority
