"""A recording that was found: its place, its frames with their times, and a digest of its files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from beltscape.reprocessing.recordings.place import Place


@dataclass(frozen=True, slots=True)
class RecordedFrame:
    """One trigger instant of a recording."""

    frame: str
    """Name of the instant: the image files' stem."""
    time_ns: int
    position_mm: float | None
    """The encoder's position; None without one."""
    files: Mapping[str, str]
    """Camera → path in the recording's place; empty for an instant without images."""
    exposures_us: Mapping[str, float]
    """Camera → exposure time, µs; NaN while it changes; empty where the recording does not state it."""


@dataclass(frozen=True, slots=True)
class Recording:
    """A capture that can be measured; its images are not read yet. It can be pickled."""

    name: str
    """Path below the source with "/"; an archive counts as a folder."""
    place: Place
    frames: tuple[RecordedFrame, ...]
    """In the order of time."""
    start_wall_ns: int | None
    """Wall clock of the recorder when it began, ns since 1970 UTC, by the folder's name; None where it has none."""
    digest: str
    """SHA-256 of names, sizes and change marks of its files; it differs after any of them was changed."""


@dataclass(frozen=True, slots=True)
class Unreadable:
    """A recording that was found and could not be read."""

    name: str
    """Path below the source with "/"."""
    reason: str
    """One line with the fix."""
