"""The names of all alarms: kinds, and the system's checks; settings refer to one of them, also for a subject."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator

from beltscape.core.errors import suggest_name

CHECKS = (
    "camera_pose",
    "camera_pose_unchecked",
    "camera_redundancy",
    "camera_sync",
    "carry_back",
    "carry_back_stuck",
    "carry_back_total",
    "condensation",
    "defocus",
    "dirt",
    "dust",
    "encoder_motion",
    "exposure",
    "flicker",
    "foreign_object",
    "frozen_image",
    "lamp",
    "lens_covered",
    "maintenance",
    "overexposure",
    "projector",
    "projector_focus",
    "projector_moved",
    "splice",
    "sunlight",
    "thin_overlap",
    "torn_edge_left",
    "torn_edge_right",
    "zero_drift",
    "zero_shift",
    "zero_tilt",
)
"""Names of all checks in alphabetical order; a test compares them with the source."""


def require_check(name: str) -> str:
    """Return the name of a check; ValueError with the most similar one if there is none of that name."""
    if name in CHECKS:
        return name
    hint = suggest_name(name, CHECKS) or f"give one of {', '.join(CHECKS)}"
    raise ValueError(f"no check is called {name!r}; {hint}")


KINDS = (
    "no_measurement",
    "overload",
    "oversize_lump",
    "misaligned_belt",
    "belt_stopped",
    "empty",
    "low_coverage",
    "cameras_off",
    "camera_lost",
    "camera_skew",
    "frames_dropped",
    "disk_full",
    "history_repaired",
    "users_unreadable",
    "reports_failing",
    "recording_paused",
    "encoder_silent",
    "encoder_wrong",
    "certificate_expiring",
)
"""Kinds of the alarms that are not those of checks, in the order of display; each has settings and a rule."""


def split_name(name: str) -> tuple[str, str]:
    """Return kind and subject of an alarm's name: "camera_lost:cam2" has both, "overload" has no subject."""
    kind, _, subject = name.partition(":")
    return kind, subject


def list_keys(name: str) -> tuple[str, ...]:
    """Return the keys under which a table may have an alarm, the most specific first: its name, its kind."""
    kind = split_name(name)[0]
    return (name,) if kind == name else (name, kind)


def require_alarm(name: str) -> str:
    """Return the name of an alarm; ValueError with the most similar kind if its kind does not exist."""
    kind = split_name(name)[0]
    known = (*KINDS, *CHECKS)
    if kind in known:
        return name
    hint = suggest_name(kind, known) or f"give one of {', '.join(known)}"
    raise ValueError(f"no alarm is called {name!r}; {hint}")


AlarmKey = Annotated[str, AfterValidator(require_alarm)]
"""Name of an alarm, or of a kind of alarms: "camera_lost:cam2" or "camera_lost"."""
