"""Encoders that nothing need be listened for: a recorded table, a told speed."""

from __future__ import annotations

from pathlib import Path

from beltscape.files.encoder_csv import read_encoder


class TableEncoder:
    """A capture's encoder.csv, by frame name; positions as they stand there."""

    def __init__(self, path: Path) -> None:
        """InputError where the table does not fit."""
        self._positions_mm = {one.frame: one.belt_position_mm for one in read_encoder(path)}

    def at(self, time_ns: int | None, frame: str) -> float | None:  # noqa: ARG002
        """Position in that frame; None for one that the table does not name."""
        return self._positions_mm.get(frame)

    @property
    def silent_s(self) -> float:
        """It cannot be silent."""
        return float("nan")

    @property
    def trouble(self) -> str:
        """The table was read as a whole."""
        return ""

    def close(self) -> None:
        """Nothing is open."""


class ConstantEncoder:
    """A belt that always runs at one speed, from the first frame on; what passed before that is not known."""

    def __init__(self, speed_mm_s: float, start_mm: float = 0.0) -> None:
        """``start_mm``: where the ledger of the belt ended."""
        self._speed_mm_s, self._start_mm = speed_mm_s, start_mm
        self._first_ns: int | None = None

    def at(self, time_ns: int | None, frame: str) -> float | None:  # noqa: ARG002
        """Position at a time; None for a frame whose time is not known."""
        if time_ns is None:
            return None
        if self._first_ns is None:
            self._first_ns = time_ns
        return self._start_mm + self._speed_mm_s * ((time_ns - self._first_ns) * 1e-9)

    @property
    def silent_s(self) -> float:
        """It cannot be silent."""
        return float("nan")

    @property
    def trouble(self) -> str:
        """Nobody listens to it."""
        return ""

    def close(self) -> None:
        """Nothing is open."""
