"""The results of locating a frame: its position, what was observed of the belt's motion, and what is predicted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.live.findings import Finding
from beltscape.measure.flow.motion.belt_motion import BeltPosition
from beltscape.measure.flow.motion.encoder_check import Contradiction
from beltscape.measure.flow.motion.recount import LocatedFrame
from beltscape.measure.flow.motion.registration.shift import Shift


@dataclass(frozen=True, slots=True)
class Location:
    """The position assigned to a frame."""

    place: BeltPosition | None
    """None: unknown."""
    shift: Shift | None
    """Motion of the material since the key frame."""
    is_encoder_trusted: bool
    contradiction: Contradiction | None
    """A contradiction between encoder and material that was noticed in this frame."""
    finding: Finding | None
    """The finding about the encoder; None without an encoder."""
    has_turned: bool
    """Whether the direction of travel, which was only assumed before, turned out to be the other one."""
    is_sudden: bool = False
    """Whether the encoder's speed changed faster than a belt's, and neither returned nor was confirmed since."""
    is_stalled: bool = False
    """Whether the frame shows the material where the frame before showed it, while a trusted encoder counts."""
    relocated: tuple[LocatedFrame, ...] = ()
    """Earlier frames with new positions: the contradiction shows that the encoder located them wrongly."""


@dataclass(frozen=True, slots=True)
class Observation:
    """The material's motion in a frame."""

    shift: Shift | None = None
    """Since the key frame; None: not known."""
    contradiction: Contradiction | None = None
    """With the encoder."""
    is_uncertain: bool = False
    """Whether the material is not where the encoder puts it; while it is not trusted: whether it does not stand."""
    is_stalled: bool = False
    """Whether the material stands still since the frame before, while a trusted encoder counts."""


@dataclass(frozen=True, slots=True, eq=False)
class MotionPrediction:
    """The prediction of the motion after a frame."""

    along: NDArray[np.float64]
    """(3,) direction of travel in the core's frame."""
    ratio: float
    """Encoder's over the material's motion."""
    speed: float | None
    """mm per unit of the meter's clock; None if unknown."""
    uses_encoder: bool = True
    """Whether the encoder is trusted."""

    def predict_step_mm(self, last: BeltPosition, clock: float, encoder_mm: float | None) -> float:
        """Return the travel from the last position to a coming frame; inf if it is not known."""
        if encoder_mm is not None and last.encoder_mm is not None and self.uses_encoder:
            return max((encoder_mm - last.encoder_mm) / self.ratio, 0.0)
        return float("inf") if self.speed is None else max(self.speed * (clock - last.clock), 0.0)


@dataclass(frozen=True, slots=True)
class FramePlacement:
    """The position assigned to one frame."""

    frame: str
    place: BeltPosition
    shift: Shift | None
    """Motion of the material since the key frame."""
    is_encoder_trusted: bool = True
    """Whether encoder and material agree as far as both are known."""
