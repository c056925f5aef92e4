"""Opening of the encoder that the settings describe."""

from __future__ import annotations

from pathlib import Path

from beltscape.core.errors import InputError
from beltscape.sources.encoder.offset import EncoderOffset
from beltscape.sources.encoder.protocol import Encoder
from beltscape.sources.encoder.settings import EncoderSettings
from beltscape.sources.encoder.simple import ConstantEncoder, TableEncoder
from beltscape.sources.encoder.tail import TailEncoder
from beltscape.sources.encoder.udp import UdpEncoder


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
