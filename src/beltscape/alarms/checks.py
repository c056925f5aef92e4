"""The names of the system's checks, each of which may raise an alarm of its name."""

from __future__ import annotations

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
