"""A frame as it was pushed to the meter."""

from __future__ import annotations

from dataclasses import dataclass

from beltscape.core.depth import DepthMap
from beltscape.measure.flow.motion.high_pass import Relief


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A frame that was pushed."""

    frame: str
    depth: DepthMap | None
    """None for a frame that gave none."""
    time_ns: int | None
    clock: float
    """Seconds, or the frame's number where nobody told the time."""
    encoder_mm: float | None
    """What the encoder said."""
    relief: Relief | None
    """By which its material is recognised in the next frame."""
    whole: bool
    """Whether every camera gave its image."""
