"""The result of a piece: its entries of the ledger, what its checks found, and where its time went."""

from __future__ import annotations

from dataclasses import dataclass

from beltscape.core.belt.ledger_entries import BeltRecord


@dataclass(frozen=True, slots=True)
class PieceTimes:
    """Times of the steps of a piece."""

    setup_s: float
    """Until the first image: settings, rig, empty belt, networks."""
    read_s: float
    """Reading of files, beside the measurement."""
    decode_s: float
    """Decoding of images, beside the measurement."""
    total_s: float
    read_bytes: int
    frames: int
    """Number of frames that were measured, the leads included."""


@dataclass(frozen=True, slots=True)
class PieceResult:
    """The measurement of a piece."""

    entries: tuple[BeltRecord, ...]
    """Those of the own frames, without densities; belt positions are the encoder's, or begin anywhere without one."""
    warnings: tuple[str, ...]
    """What was found about images, cameras and encoder, each once."""
    times: PieceTimes
