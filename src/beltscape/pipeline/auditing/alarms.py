"""Alarms of a period from the journal: when each was raised, who acknowledged or hid it, and when it was over."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field

from beltscape.core.checks import is_dict
from beltscape.sinks.historian.events import Event

_ENDED = frozenset({"clear", "gone", "latched"})
"""States in which the condition of an alarm is over."""
_HIDING = frozenset({"shelved", "out_of_service"})


@dataclass(slots=True)
class AlarmEpisode:
    """One time that an alarm was on."""

    name: str
    raised_ns: int
    text: str
    """Its line when it was raised."""
    ended_ns: int | None = None
    """None: it was still on at the end of the journal that was read."""
    acknowledged_by: str = ""
    acknowledged_ns: int | None = None
    hidden_by: list[str] = field(default_factory=list[str])
    """Who shelved it or took it out of service, with the reason."""


def pair_alarms(events: Iterable[Event], since_ns: int, until_ns: int) -> list[AlarmEpisode]:
    """Return the alarms that were on in a period, in the order in which they were raised.

    ``events`` are the journal, oldest first, from some time before the period to some time after it.
    """
    present: dict[str, AlarmEpisode] = {}
    last: dict[str, AlarmEpisode] = {}
    episodes: list[AlarmEpisode] = []
    for event in events:
        parts = _read_parameters(event.parameters)
        state, action = parts.get("state"), parts.get("action")
        episode = present.get(event.name) or last.get(event.name)
        if action in _HIDING and episode is not None:
            episode.hidden_by.append(f"{event.by}: {parts.get('reason', '')}")
        elif state == "raised" and event.name not in present:
            episode = AlarmEpisode(event.name, event.wall_ns, event.text.partition(": ")[2] or event.text)
            present[event.name] = last[event.name] = episode
            episodes.append(episode)
        elif state == "acknowledged" and event.by and episode is not None and not episode.acknowledged_by:
            episode.acknowledged_by, episode.acknowledged_ns = event.by, event.wall_ns
        elif state in _ENDED and event.name in present:
            present.pop(event.name).ended_ns = event.wall_ns
    return [
        one
        for one in episodes
        if one.raised_ns < until_ns and (one.ended_ns is None or one.ended_ns >= since_ns)
    ]


def _read_parameters(text: str) -> dict[str, object]:
    try:
        value = json.loads(text) if text else {}
    except ValueError:
        return {}
    return value if is_dict(value) else {}
