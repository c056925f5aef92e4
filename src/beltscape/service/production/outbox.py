"""The outbox of reports: a report that is to be delivered has a mark, a file beside it; so has one that was."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from beltscape.core.errors import InputError
from beltscape.files.folders.durable import keep_state

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Outbox:
    """The marks of one way of delivery."""

    folder: Path
    """The folder of the reports."""
    waiting: str
    """Ending of the mark of a report that is to be delivered."""
    done: str
    """Ending of the mark of a delivered report."""

    def mark(self, key: str) -> None:
        """Mark a report as to be delivered; it is, once it is written. OutputError if the disk refuses it."""
        keep_state(self.folder / f"{key}{self.waiting}", b"")

    @property
    def is_empty(self) -> bool:
        """Return whether nothing waits."""
        return not any(self.folder.glob(f"*{self.waiting}"))

    def is_done(self, key: str) -> bool:
        """Return whether a report was delivered."""
        waits = (self.folder / f"{key}{self.waiting}").exists()
        return not waits and (self.folder / f"{key}{self.done}").exists()

    def deliver(self, prepare: Callable[[str], Item], send: Callable[[Item], None]) -> None:
        """Send every report that waits, the oldest first.

        The error of ``send`` ends the round: that report and the later ones go on waiting. After an InputError of
        ``prepare``, which says that the report itself is damaged, it no longer waits. After a power cut before the
        mark of a sent report is changed, it is sent twice.
        """
        for mark in sorted(self.folder.glob(f"*{self.waiting}")):
            key = mark.name.removesuffix(self.waiting)
            if not (self.folder / f"{key}.html").is_file():
                continue  # it is being written
            try:
                item = prepare(key)
            except InputError:
                mark.unlink(missing_ok=True)
                raise
            send(item)
            mark.replace(mark.with_name(f"{key}{self.done}"))
