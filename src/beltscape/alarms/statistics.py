"""Key figures of the alarm system over a period, as ANSI/ISA-18.2-2016 (clause 16) and IEC 62682 monitor it."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from beltscape.core.alarms import PRIORITIES, Alarm, Priority

_S_NS = 1_000_000_000
"""Nanoseconds of a second."""
WINDOW_NS = 600 * _S_NS
"""Ten minutes, the interval in which both standards count alarms for one operator."""
FLOOD_BEGINS, FLOOD_ENDS = 10, 5
"""A flood begins with more than 10 alarms in ten minutes, and ends with fewer than 5 (ANSI/ISA-18.2)."""
_CHATTERING_COUNT, _CHATTERING_NS = 3, 60 * _S_NS
"""An alarm chatters that is raised three times in a minute (ANSI/ISA-18.2, EEMUA 191)."""
_STALE_NS = 24 * 3600 * _S_NS
"""An alarm is stale that stands for more than a day (ANSI/ISA-18.2)."""
_TOP = 10
"""Length of the list of the most frequent alarms (ANSI/ISA-18.2)."""


@dataclass(frozen=True, slots=True)
class Annunciation:
    """An alarm that was raised and shown."""

    wall_ns: int
    """System clock."""
    name: str
    priority: Priority


@dataclass(frozen=True, slots=True)
class Frequency:
    """Number of times that one alarm was raised."""

    name: str
    count: int
    share: float
    """Of all alarms, 0..1."""


@dataclass(frozen=True, slots=True)
class AlarmStatistics:
    """Key figures of a period."""

    count: int
    """Alarms that were raised and shown."""
    mean_per_10_min: float
    """NaN for an empty period."""
    peak_per_10_min: int
    """Largest number in any ten minutes."""
    last_10_min: int
    """Number in the last ten minutes of the period."""
    flood_share: float
    """Share of the time that belongs to floods, 0..1."""
    floods: int
    """Number of floods."""
    is_flood: bool
    """Whether a flood goes on at the end of the period."""
    top: tuple[Frequency, ...]
    """The most frequent alarms."""
    chattering: tuple[str, ...]
    """Names of the alarms that were raised three times in a minute."""
    stale: tuple[str, ...]
    """Names of the alarms that stand for more than a day."""
    by_priority: Mapping[Priority, int]


def compute_statistics(
    raised: Iterable[Annunciation], since_ns: int, until_ns: int, present: Sequence[Alarm] = ()
) -> AlarmStatistics:
    """Return the key figures of a period from the alarms raised in it and those that are present at its end."""
    inside = sorted(
        (one for one in raised if since_ns <= one.wall_ns < until_ns), key=lambda one: one.wall_ns
    )
    times_ns = [one.wall_ns for one in inside]
    floods, flood_ns, peak = _find_floods(times_ns, until_ns)
    length_ns = until_ns - since_ns
    counts = Counter(one.name for one in inside)
    priorities = Counter(one.priority for one in inside)
    return AlarmStatistics(
        count=len(inside),
        mean_per_10_min=len(inside) * WINDOW_NS / length_ns if length_ns > 0 else float("nan"),
        peak_per_10_min=peak,
        last_10_min=sum(time_ns > until_ns - WINDOW_NS for time_ns in times_ns),
        flood_share=flood_ns / length_ns if length_ns > 0 else 0.0,
        floods=len(floods),
        is_flood=bool(floods) and floods[-1][1] == until_ns,
        top=tuple(Frequency(name, n, n / len(inside)) for name, n in counts.most_common(_TOP)),
        chattering=_find_chattering(inside),
        stale=tuple(a.name for a in present if a.since_ns is not None and until_ns - a.since_ns > _STALE_NS),
        by_priority={priority: priorities[priority] for priority in PRIORITIES},
    )


def _find_floods(times_ns: Sequence[int], until_ns: int) -> tuple[list[tuple[int, int]], int, int]:
    """Return begin and end of every flood, their length together, and the largest number in ten minutes.

    ``times_ns`` ascends. The number in the last ten minutes changes when an alarm comes and ten minutes after it.
    """
    window: deque[int] = deque()
    floods: list[tuple[int, int]] = []
    begin_ns: int | None = None
    peak = 0
    for time_ns in [*times_ns, until_ns + 2 * WINDOW_NS]:
        while window and window[0] + WINDOW_NS <= time_ns:
            left_ns = window.popleft() + WINDOW_NS
            if begin_ns is not None and len(window) < FLOOD_ENDS:
                floods.append((begin_ns, min(left_ns, until_ns)))
                begin_ns = None
        window.append(time_ns)
        if time_ns >= until_ns:
            break
        peak = max(peak, len(window))
        if begin_ns is None and len(window) > FLOOD_BEGINS:
            begin_ns = time_ns
    return floods, sum(end - begin for begin, end in floods), peak


def _find_chattering(raised: Sequence[Annunciation]) -> tuple[str, ...]:
    """Return the alarms that were raised three times in a minute, in the order in which they did."""
    last: dict[str, deque[int]] = {}
    found: dict[str, None] = {}
    for one in raised:
        times = last.setdefault(one.name, deque(maxlen=_CHATTERING_COUNT))
        times.append(one.wall_ns)
        if len(times) == _CHATTERING_COUNT and times[-1] - times[0] <= _CHATTERING_NS:
            found[one.name] = None
    return tuple(found)
