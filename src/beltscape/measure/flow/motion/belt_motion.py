"""Where the belt is at each frame: from the material, the encoder, or the last known speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from beltscape.measure.flow.motion.encoder_scale import EncoderScale

Source = Literal["start", "material", "encoder", "speed"]
_ENCODER_JITTER_MM = 0.2
_SPEED_CHANGE = 0.05
"""One standard deviation of a belt's speed after a second, as a share of it, where nothing tells."""
_SPEED_KNOWN = 0.01
AGREE = 0.25
"""Encoder and material differ by no more than that share, or one of them tells of something else."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """What is known of one frame's place before it is placed."""

    clock: float
    """Seconds, or the frame's number where nobody told the time."""
    encoder_mm: float | None
    """What the encoder said."""
    shift_mm: float | None
    """Motion along the travel since the key frame as the material tells it; None where it does not."""
    shift_sigma_mm: float
    """One standard deviation of it."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where the belt was in a frame."""

    position_mm: float
    """Along the travel, from 0 (or the encoder's first reading) at the first frame."""
    sigma_mm: float
    """One standard deviation of the step since the key frame."""
    source: Source
    """What told it."""
    clock: float
    """As in `Sighting`."""
    encoder_mm: float | None
    """As in `Sighting`."""


class Motion:
    """Places frame after frame; positions are relative to a key frame that the caller moves on."""

    def __init__(self) -> None:
        self.scale = EncoderScale()
        self.speed: float | None = None
        """mm per unit of the clock; None until the material or an encoder told it."""
        self.key: Place | None = None
        self.last: Place | None = None

    def expected_mm(self, clock: float, encoder_mm: float | None) -> float | None:
        """How far the belt should have moved since the key frame."""
        if self.key is None:
            return None
        if encoder_mm is not None and self.key.encoder_mm is not None:
            return (encoder_mm - self.key.encoder_mm) / self.scale.ratio
        return None if self.speed is None else self.speed * (clock - self.key.clock)

    def place(self, sighting: Sighting) -> Place | None:
        """Where the belt is; None where nothing tells."""
        if self.key is None or self.last is None:
            start = sighting.encoder_mm or 0.0
            self.key = self.last = Place(start, 0.0, "start", sighting.clock, sighting.encoder_mm)
            return self.last
        placed = self._from_material(sighting) or self._from_encoder(sighting) or self._from_speed(sighting)
        if placed is None:
            return None
        elapsed = sighting.clock - self.last.clock
        if placed.source != "speed" and elapsed > 0:
            self.speed = (placed.position_mm - self.last.position_mm) / elapsed
        self.last = placed
        return placed

    def move_key(self) -> None:
        """Make the last frame the key frame; what encoder and material said up to it is compared once."""
        key, last = self.key, self.last
        if key is None or last is None:
            return
        if last.source == "material" and last.encoder_mm is not None and key.encoder_mm is not None:
            self.scale.compare(
                last.encoder_mm - key.encoder_mm, last.position_mm - key.position_mm, last.sigma_mm
            )
        self.key = last

    def _from_material(self, sighting: Sighting) -> Place | None:
        key = self.key
        if key is None or sighting.shift_mm is None:
            return None
        return self._placed(
            key.position_mm + sighting.shift_mm, sighting.shift_sigma_mm, "material", sighting
        )

    def _from_encoder(self, sighting: Sighting) -> Place | None:
        key = self.key
        if key is None or sighting.encoder_mm is None or key.encoder_mm is None:
            return None
        step = (sighting.encoder_mm - key.encoder_mm) / self.scale.ratio
        sigma = float(np.hypot(_ENCODER_JITTER_MM, self.scale.sigma * step))
        return self._placed(key.position_mm + step, sigma, "encoder", sighting)

    def _from_speed(self, sighting: Sighting) -> Place | None:
        last = self.last
        if last is None or self.speed is None:
            return None
        elapsed = sighting.clock - last.clock
        step = self.speed * elapsed
        grown = last.sigma_mm if last.source == "speed" else 0.0
        sigma = float(
            np.hypot(grown, abs(step) * np.hypot(_SPEED_KNOWN, _SPEED_CHANGE * np.sqrt(max(elapsed, 0))))
        )
        return self._placed(last.position_mm + step, sigma, "speed", sighting)

    @staticmethod
    def _placed(position_mm: float, sigma_mm: float, source: Source, sighting: Sighting) -> Place:
        return Place(position_mm, sigma_mm, source, sighting.clock, sighting.encoder_mm)
