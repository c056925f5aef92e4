"""The last minutes of recording, in short captures of which the oldest is given up."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from pathlib import Path

from beltscape.sinks.recording.capture_store import Shelf

PARTS = 12
"""Pieces of the ring; one goes at a time."""


@dataclass(frozen=True, slots=True)
class Piece:
    """A short capture in the ring."""

    folder: Path
    begun_s: float
    """On a clock that never jumps."""
    goes_on: bool
    """Whether it follows the piece before it as one capture."""


class Ring:
    """Pieces in the order of recording."""

    def __init__(self, shelf: Shelf, reach_s: float, now_s: float) -> None:
        """What an earlier run left counts as of now: it goes when its time has passed once more."""
        self._shelf, self._reach_s = shelf, reach_s
        self._pieces = deque(Piece(folder, now_s, goes_on=False) for folder in shelf.of("ring"))

    def __bool__(self) -> bool:
        return bool(self._pieces)

    def add(self, folder: Path, now_s: float, *, goes_on: bool) -> None:
        """A new piece begins; those that the ring no longer reaches back to are given up."""
        self._pieces.append(Piece(folder, now_s, goes_on))
        # a piece ends where the next one begins
        while len(self._pieces) > 1 and self._pieces[1].begun_s < now_s - self._reach_s:
            self.drop_oldest()

    def drop_oldest(self) -> bool:
        """Give up the oldest piece, not the one being written; whether there was one."""
        if len(self._pieces) < 2:
            return False
        self._shelf.remove(self._pieces.popleft().folder)
        return True

    def keep(self, target: Path) -> None:
        """Move all pieces to ``target``; what does not belong to the newest capture goes beside it."""
        groups: list[list[Path]] = []
        names: set[str] = set()
        for piece in self._pieces:
            if not piece.folder.is_dir():
                continue  # nothing was written into it
            its = {image.stem for image in piece.folder.glob("*/*")}
            if groups and piece.goes_on and not names & its:
                groups[-1].append(piece.folder)
                names |= its
            else:
                groups.append([piece.folder])
                names = its
        self._pieces.clear()
        for place, group in enumerate(groups):
            before = len(groups) - 1 - place
            self._shelf.merge(
                group, target if not before else target.with_name(f"{target.name}-before{before}")
            )
