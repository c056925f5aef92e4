"""Encoders without a device: a recorded table, a constant speed."""

from __future__ import annotations

from pathlib import Path

from beltscape.files.tables.encoder_csv import read_encoder


class _CompleteEncoder:
    """The part that encoders without readings have in common: nothing can fall silent or fail."""

    @property
    def silent_s(self) -> float:
        """NaN: it cannot fall silent."""
        return float("nan")

    @property
    def trouble(self) -> str:
        """Empty: a table is checked as a whole when it is read, and a speed has no readings."""
        return ""

    def close(self) -> None:
        """Do nothing."""


class TableEncoder(_CompleteEncoder):
    """Positions of a capture's encoder.csv, by frame name."""

    def __init__(self, path: Path) -> None:
        """Read the table; InputError if it is invalid."""
        self._positions_mm = {reading.frame: reading.belt_position_mm for reading in read_encoder(path)}

    def position_at(self, time_ns: int | None, frame: str) -> float | None:  # noqa: ARG002
        """Return the position in that frame; None for a frame that is not in the table."""
        return self._positions_mm.get(frame)


class ConstantEncoder(_CompleteEncoder):
    """A belt that runs at one speed from the first frame on; travel before that frame is unknown."""

    def __init__(self, speed_mm_s: float, start_mm: float = 0.0) -> None:
        """``start_mm``: the end of the belt ledger."""
        self._speed_mm_s, self._start_mm = speed_mm_s, start_mm
        self._first_ns: int | None = None

    def position_at(self, time_ns: int | None, frame: str) -> float | None:  # noqa: ARG002
        """Return the position at a time; None for a frame without a time."""
        if time_ns is None:
            return None
        if self._first_ns is None:
            self._first_ns = time_ns
        return self._start_mm + self._speed_mm_s * ((time_ns - self._first_ns) * 1e-9)
