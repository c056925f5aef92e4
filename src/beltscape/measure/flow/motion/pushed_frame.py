"""A frame pushed to the flow meter."""

from __future__ import annotations

from dataclasses import dataclass, field

from beltscape.core.depth import DepthMap
from beltscape.core.live.findings import Finding, worst_effect
from beltscape.measure.flow.motion.registration.high_pass import HighPassHeights


@dataclass(frozen=True, slots=True, eq=False)
class PushedFrame:
    """A frame pushed to the flow meter."""

    frame: str
    depth: DepthMap | None
    """None for a frame without a depth map."""
    time_ns: int | None
    clock: float
    """Seconds, or the frame's number without times."""
    encoder_mm: float | None
    """Reading of the encoder."""
    high_pass: HighPassHeights | None
    """High-pass heights, registered with those of the next frame."""
    whole: bool
    """Whether every camera gave its image."""
    number: int = 0
    """Number of the frame since the start."""
    findings: list[Finding] = field(default_factory=list)
    """The findings that concern it; those of later frames are added while it waits."""

    @property
    def is_measured(self) -> bool:
        """Return whether its surface enters the measurement."""
        return self.depth is not None and worst_effect(self.findings) != "missing"
