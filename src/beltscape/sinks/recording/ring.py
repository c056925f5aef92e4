"""The ring of the last minutes of recording: short captures, of which the oldest is removed."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from pathlib import Path

from beltscape.sinks.recording.capture_store import CaptureStore

PARTS = 12
"""Number of pieces of the ring, of which one is removed at a time: it holds 11/12 of its length or more."""


@dataclass(frozen=True, slots=True)
class Piece:
    """A short capture in the ring."""

    folder: Path
    start_s: float
    """Beginning on a monotonic clock."""
    is_continuation: bool
    """True if it belongs to the same capture as the piece before."""


class Ring:
    """The pieces of the ring in the order of recording."""

    def __init__(self, store: CaptureStore, reach_s: float, now_s: float) -> None:
        """Take over an earlier run's pieces as if recorded now; they are removed after the ring's length."""
        self._store, self._reach_s = store, reach_s
        self._pieces = deque(
            Piece(folder, now_s, is_continuation=False) for folder in store.list_captures("ring")
        )

    def __bool__(self) -> bool:
        return bool(self._pieces)

    def add(self, folder: Path, now_s: float, *, is_continuation: bool) -> None:
        """Add a new piece; remove those older than the ring's length."""
        self._pieces.append(Piece(folder, now_s, is_continuation))
        # a piece ends where the next one begins
        while len(self._pieces) > 1 and self._pieces[1].start_s < now_s - self._reach_s:
            self.drop_oldest()

    def drop_oldest(self) -> bool:
        """Remove the oldest piece, except the one being written; return whether there was one."""
        if len(self._pieces) < 2:
            return False
        self._store.remove(self._pieces.popleft().folder)
        return True

    def keep(self, target: Path) -> None:
        """Move all pieces to ``target``; pieces that are not of the newest capture go to folders beside it."""
        groups: list[list[Path]] = []
        names: set[str] = set()
        for piece in self._pieces:
            if not piece.folder.is_dir():
                continue  # nothing was written into it
            piece_names = {image.stem for image in piece.folder.glob("*/*")}
            if groups and piece.is_continuation and not names & piece_names:
                groups[-1].append(piece.folder)
                names |= piece_names
            else:
                groups.append([piece.folder])
                names = piece_names
        self._pieces.clear()
        for place, group in enumerate(groups):
            before = len(groups) - 1 - place
            self._store.merge(
                group, target if not before else target.with_name(f"{target.name}-before{before}")
            )
