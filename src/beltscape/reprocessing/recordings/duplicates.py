"""Recordings that a source holds more than once, such as in a folder and in a day archive."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256

from beltscape.files.frame_names import natural_key
from beltscape.reprocessing.recordings.recording import Recording, Unreadable
from beltscape.reprocessing.recordings.tree import find_archive_kind


def separate_duplicates(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Unreadable]]:
    """Return each recording once, in natural order of the names, and a line for every other copy.

    Copies have the name of the capture, its frames, times and positions in common. The copy with most images is kept,
    of several that in a folder, which is read faster than an archive.
    """
    kept: dict[str, Recording] = {}
    copies: list[Unreadable] = []
    for recording in sorted(recordings, key=_rank):
        first = kept.setdefault(_identify(recording), recording)
        if first is not recording:
            reason = (
                f"is the same recording as {first.name} (name, frames, times and positions are equal) "
                "and is counted once; remove one of them"
            )
            copies.append(Unreadable(recording.name, reason))
    return sorted(kept.values(), key=lambda one: natural_key(one.name)), copies


def _rank(recording: Recording) -> tuple[int, bool, tuple[tuple[int, int | str], ...]]:
    images = sum(len(frame.files) for frame in recording.frames)
    return -images, recording.place.archive is not None, natural_key(recording.name)


def _identify(recording: Recording) -> str:
    """Return a digest of the capture's name, frames, times and positions."""
    base = recording.name.rpartition("/")[2]
    end = base if find_archive_kind(base) is None else base.partition(".")[0]
    rows = (f"{frame.frame}\0{frame.time_ns}\0{frame.position_mm!r}\n" for frame in recording.frames)
    return sha256("".join([end, "\n", *rows]).encode("utf-8", "surrogateescape")).hexdigest()
