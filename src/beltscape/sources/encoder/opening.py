"""The interface of all encoders, the encoders without a device, and the opening of the one that settings describe."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from beltscape.core.errors import InputError
from beltscape.files.encoder_csv import read_encoder
from beltscape.sources.encoder.readings import EncoderOffset
from beltscape.sources.encoder.settings import EncoderSettings
from beltscape.sources.encoder.tail import TailEncoder
from beltscape.sources.encoder.udp import UdpEncoder


class Encoder(Protocol):
    """Source of the belt's position; usable from any thread."""

    def position_at(self, time_ns: int | None, frame: str) -> float | None:
        """Return the position (mm) at a frame's monotonic time; None: no reading near it."""
        ...

    @property
    def silent_s(self) -> float:
        """Seconds since the last reading, or since opening; NaN for encoders that cannot fall silent."""
        ...

    @property
    def trouble(self) -> str:
        """The fault of its readings, and the fix, in one line; empty without a fault."""
        ...

    def close(self) -> None:
        """Stop receiving readings."""
        ...


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


def open_encoder(
    settings: EncoderSettings,
    beside: Path,
    *,
    capture: Path | None = None,
    data: Path | None = None,
    resume_mm: float | None = None,
) -> Encoder | None:
    """Open the encoder; return None for "camera" (frame sets carry their position) and "none".

    ``beside`` is the folder that paths are relative to, ``capture`` the replayed capture, ``data`` the folder in
    which a reset encoder's offset is stored, ``resume_mm`` the end of the belt ledger.

    Raises
    ------
    InputError
        When its table is invalid or its address cannot be opened.
    """
    offset = None if data is None else EncoderOffset(data / "encoder.json", settings)
    match settings.kind:
        case "file":
            return TailEncoder(beside / settings.path, settings, offset, resume_mm)
        case "udp":
            return UdpEncoder(settings, offset, resume_mm)
        case "constant":
            return ConstantEncoder(settings.speed_mm_s or 0.0, resume_mm or 0.0)
        case "capture":
            return TableEncoder(_table(settings, beside, capture))
        case _:
            return None


def _table(settings: EncoderSettings, beside: Path, capture: Path | None) -> Path:
    if settings.path:
        return beside / settings.path
    if capture is None:
        raise InputError('encoder: kind "capture" is for a replay; with cameras choose file, udp or camera')
    return capture / "encoder.csv"
