"""Suppression by design: alarms that say nothing new while the plant is in a state that explains them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from beltscape.alarms.names import list_keys, split_name

MAINTENANCE, BELT_STOPPED, CAMERAS_OFF = "maintenance", "belt_stopped", "cameras_off"
FRAMES_DROPPED = "frames_dropped"
"""The states of the plant that suppress alarms."""


def select_state(
    name: str,
    states: Sequence[str],
    suppressed: Mapping[str, Collection[str]],
    off_cameras: Collection[str],
    cameras: Collection[str],
) -> str:
    """Return the state of the plant that suppresses an alarm; empty: none does.

    ``suppressed`` has the alarms of every state. An alarm of one camera is suppressed with a bank of cameras only if
    the camera belongs to it (``off_cameras``); ``cameras`` are all.
    """
    subject = split_name(name)[1]
    for state in states:
        if not any(key in suppressed[state] for key in list_keys(name)):
            continue
        if state == CAMERAS_OFF and subject in cameras and subject not in off_cameras:
            continue
        return state
    return ""
