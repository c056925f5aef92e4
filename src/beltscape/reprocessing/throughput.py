"""Speed, efficiency and projected cost of a re-processing, while it runs and after it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from beltscape.files.json_text import write_json
from beltscape.reprocessing.manifest import WorkSpan
from beltscape.reprocessing.pieces import Piece, PieceTimes

PROGRESS = "progress.json"
_WRITE_S = 2.0
"""Shortest time between two updates of the file."""


class Throughput:
    """Collects the times of the pieces measured in this run, and keeps a file with the projection."""

    def __init__(self, store: Path, pieces: int) -> None:
        """``pieces`` is the number of all pieces, those of earlier runs included."""
        self._path, self._pieces = store / PROGRESS, pieces
        self._times: list[PieceTimes] = []
        self._workers: set[str] = set()
        self._own_frames = self._missing_frames = 0
        self._busy_s = self._wall_s = 0.0
        self._began_s = time.perf_counter()
        self._written_s = float("-inf")

    @property
    def done(self) -> int:
        """Return the number of pieces measured in this run."""
        return len(self._times)

    def begin(self, missing: Sequence[Piece]) -> None:
        """Begin to measure these pieces."""
        self._missing_frames = sum(len(piece.own) for piece in missing)
        self._began_s = time.perf_counter()

    def add(self, piece: Piece, times: PieceTimes, span: WorkSpan) -> None:
        """Add a piece that was measured."""
        self._times.append(times)
        self._workers.add(span.worker)
        self._own_frames += len(piece.own)
        self._busy_s += span.seconds
        self._wall_s = time.perf_counter() - self._began_s
        if self._wall_s - self._written_s >= _WRITE_S:
            self._written_s = self._wall_s
            write_json(self._path, self.describe())

    def end(self) -> None:
        """Write the file for the last time."""
        self._wall_s = time.perf_counter() - self._began_s
        write_json(self._path, self.describe())

    def describe(self) -> dict[str, Any]:
        """Return the figures as plain values; null before the first piece."""
        own, busy_s, wall_s = self._own_frames, self._busy_s, self._wall_s
        is_known = own > 0 and wall_s > 0
        workers, left = len(self._workers), self._missing_frames - own
        return {
            "pieces": self._pieces,
            "measured_now": self.done,
            "frames": own,
            "frames_left": left,
            "workers": workers,
            "wall_s": wall_s,
            "worker_s": busy_s,
            "frames_per_s": own / wall_s if is_known else None,
            "efficiency": busy_s / (workers * wall_s) if is_known else None,
            "setup_s_per_piece": self._mean("setup_s"),
            "overlap_share": 1 - own / sum(one.frames for one in self._times) if is_known else None,
            "read_s": sum(one.read_s for one in self._times),
            "decode_s": sum(one.decode_s for one in self._times),
            "read_bytes": sum(one.read_bytes for one in self._times),
            "left_s": left * wall_s / own if is_known else None,
            "left_core_h": left * busy_s / own / 3600 if is_known else None,
        }

    def _mean(self, name: str) -> float | None:
        return sum(getattr(one, name) for one in self._times) / self.done if self.done else None
