"""The belt's position at each frame: from the material, the encoder, or the last known speed.

The scale of the encoder relative to the material's motion shows slip, or a wrong setting.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

_MEMORY_MM = 100_000.0
"""Travel after which older comparisons have decayed to 1/e: a wheel wears, a scale may be corrected."""
_PRIOR_SIGMA = 0.005
"""Prior standard deviation of an encoder's scale."""


@dataclass(slots=True)
class EncoderScale:
    """Running comparison of encoder and material, bounded in memory and deterministic."""

    _encoder_mm2: float = field(default=0.0)
    _both_mm2: float = field(default=0.0)
    _material_mm2: float = field(default=0.0)
    _weight: float = field(default=0.0)
    _count: int = field(default=0)

    def compare(self, encoder_mm: float, material_mm: float, sigma_mm: float) -> None:
        """Add one step of belt as measured by the encoder and by the material."""
        fade = float(np.exp(-abs(material_mm) / _MEMORY_MM))
        weight = 1 / sigma_mm**2
        self._encoder_mm2 = fade * self._encoder_mm2 + weight * encoder_mm**2
        self._both_mm2 = fade * self._both_mm2 + weight * encoder_mm * material_mm
        self._material_mm2 = fade * self._material_mm2 + weight * material_mm**2
        self._weight = fade * self._weight + weight
        self._count += 1

    @property
    def compared(self) -> int:
        """Return the number of compared steps."""
        return self._count

    @property
    def ratio(self) -> float:
        """Return encoder over material: above 1 the encoder reads too much, or the material slips; 1 at first."""
        return self._encoder_mm2 / self._both_mm2 if self._both_mm2 > 0 else 1.0

    @property
    def scatter_mm(self) -> float:
        """Return the scatter of the single steps about the ratio; 0 for fewer than two."""
        if self._count < 2 or self._both_mm2 <= 0:
            return 0.0
        left = self._material_mm2 - self._both_mm2**2 / self._encoder_mm2
        return float(np.sqrt(max(left, 0.0) / self._weight * self._count / (self._count - 1)))

    @property
    def sigma(self) -> float:
        """Return σ of the ratio: from the material's σ, or from the steps' scatter where that is larger."""
        if self._both_mm2 <= 0:
            return _PRIOR_SIGMA
        claimed = 1 / np.sqrt(self._weight)
        number = max(1.0, self._encoder_mm2 / self._weight)  # mean square step, mm²
        scatter = self.scatter_mm / np.sqrt(self._count)
        return float(min(_PRIOR_SIGMA, max(claimed, scatter) / np.sqrt(number)))


Source = Literal["start", "material", "encoder", "speed"]
_ENCODER_JITTER_MM = 0.2
"""σ of a step due to the resolution of an encoder and the play of its wheel; assumed."""
_SPEED_CHANGE = 0.05
"""One standard deviation of a belt's speed after a second without observations, as a share of it."""
_SPEED_KNOWN = 0.01
"""σ of the speed at its last observation, as a share of it; assumed."""
FASTEST_MM_S = 20_000.0
"""No belt is faster."""
_HIGHEST_ACCELERATION_MM_S2 = 10_000.0
"""No belt starts or stops faster, as in `plausibility`."""
_NEGLIGIBLE_MM = 2.0
"""Difference of an encoder's step and the speed's that is no contradiction: resolution and jitter, as `LEAST_MM`."""
LEAST_RATIO = 0.05
"""An encoder that moves by less than this share of the material's travel stands still: its steps are no measure."""
_LONGEST_COAST = 10.0
"""Time, s, for which the last speed continues against an encoder that is not trusted; a belt stops within it."""
MAX_DISAGREEMENT = 0.25
"""Largest relative difference between encoder and material at which they count as consistent."""


@dataclass(frozen=True, slots=True)
class MotionObservation:
    """The observations of the belt's motion at one frame."""

    clock: float
    """Seconds, or the frame's number without times."""
    encoder_mm: float | None
    """Reading of the encoder."""
    shift_mm: float | None
    """Motion of the material along the travel since the key frame; None without a registration."""
    shift_sigma_mm: float
    """One standard deviation of the shift."""
    uses_encoder: bool = True
    """Whether the encoder is trusted; else its step counts only where it agrees with the last speed."""
    encoder_ratio: float = float("nan")
    """Encoder's over the material's motion of an encoder that is not trusted; NaN: unknown, or not constant."""


@dataclass(frozen=True, slots=True)
class BeltPosition:
    """The belt's position at a frame."""

    position_mm: float
    """Along the travel, from 0 (or the encoder's first reading) at the first frame."""
    sigma_mm: float
    """One standard deviation of the step since the key frame."""
    source: Source
    """Source of the position."""
    clock: float
    """See `MotionObservation`."""
    encoder_mm: float | None
    """See `MotionObservation`."""
    is_in_rig_scale: bool = True
    """Whether its step is in proportion to the rig's lengths; an encoder's is once it was compared with material."""


class BeltMotion:
    """Tracks the belt's position frame by frame, relative to a key frame that the caller updates."""

    def __init__(self) -> None:
        self.scale = EncoderScale()
        self.speed: float | None = None
        """mm per unit of the clock; None until material or encoder determined it."""
        self.key: BeltPosition | None = None
        self.last: BeltPosition | None = None
        self._observed_clock = 0.0
        """Clock of the last frame whose position was observed by material or encoder."""

    def observe_movement(self, clock: float) -> None:
        """Note that the belt was seen to move at a time, although not by how much."""
        self._observed_clock = clock

    def predict_from_speed_mm(self, clock: float) -> float | None:
        """Predict the belt's motion since the key frame by its last position and speed; None if unknown."""
        if self.key is None or self.last is None or self.speed is None:
            return None
        return self.last.position_mm - self.key.position_mm + self.speed * (clock - self.last.clock)

    def predict_mm(self, clock: float, encoder_mm: float | None) -> float | None:
        """Predict the belt's motion since the key frame by encoder or speed; None where neither is known."""
        if self.key is None:
            return None
        if encoder_mm is not None and self.key.encoder_mm is not None:
            return (encoder_mm - self.key.encoder_mm) / self.scale.ratio
        return None if self.speed is None else self.speed * (clock - self.key.clock)

    def locate(self, observation: MotionObservation) -> BeltPosition | None:
        """Return the belt's position from the best observation; None without any."""
        if self.key is None or self.last is None:
            start = observation.encoder_mm or 0.0
            self.key = self.last = BeltPosition(
                start, 0.0, "start", observation.clock, observation.encoder_mm
            )
            return self.last
        placed = self._from_material(observation)
        if observation.uses_encoder:
            placed = _select_more_certain(placed, self._from_encoder(observation))
        elif placed is None:
            placed = self._from_increment(observation)
        placed = placed or self._from_speed(observation)
        if placed is None:
            return None
        elapsed = observation.clock - self.last.clock
        if placed.source != "speed":
            self._observed_clock = placed.clock
            if elapsed > 0:
                self.speed = (placed.position_mm - self.last.position_mm) / elapsed
        self.last = placed
        return placed

    def move(self, key_mm: float, last_mm: float) -> None:
        """Correct the positions of the key frame and of the last one."""
        if self.key is not None and self.last is not None:
            self.key = replace(self.key, position_mm=key_mm)
            self.last = replace(self.last, position_mm=last_mm)

    def restart_scale(self, encoder_mm: float) -> None:
        """Begin the encoder's scale anew with a count that shows ``encoder_mm`` at the last position."""
        self.scale = EncoderScale()
        if self.key is not None and self.last is not None:
            since_key = self.last.position_mm - self.key.position_mm
            self.key = replace(self.key, encoder_mm=encoder_mm - since_key)

    def move_key(self) -> None:
        """Make the last frame the key frame, and compare encoder and material between the two."""
        key, last = self.key, self.last
        if key is None or last is None:
            return
        if last.source == "material" and last.encoder_mm is not None and key.encoder_mm is not None:
            self.scale.compare(
                last.encoder_mm - key.encoder_mm, last.position_mm - key.position_mm, last.sigma_mm
            )
        self.key = last

    def _from_material(self, observation: MotionObservation) -> BeltPosition | None:
        key = self.key
        if key is None or observation.shift_mm is None:
            return None
        return self._make_position(
            key.position_mm + observation.shift_mm, observation.shift_sigma_mm, "material", observation
        )

    def _from_encoder(self, observation: MotionObservation) -> BeltPosition | None:
        key = self.key
        if key is None or observation.encoder_mm is None or key.encoder_mm is None:
            return None
        step = (observation.encoder_mm - key.encoder_mm) / self.scale.ratio
        sigma = float(np.hypot(_ENCODER_JITTER_MM, self.scale.sigma * step))
        placed = self._make_position(key.position_mm + step, sigma, "encoder", observation)
        return replace(placed, is_in_rig_scale=self.scale.compared > 0)

    def _from_increment(self, observation: MotionObservation) -> BeltPosition | None:
        """Return the position by the step of an encoder that is not trusted, or by the speed where they differ.

        The step counts by the ratio that the material showed, if it is constant. Without any observation for long,
        the encoder's step is all that there is. σ covers both.
        """
        last = self.last
        if last is None or observation.encoder_mm is None or last.encoder_mm is None:
            return None
        ratio = observation.encoder_ratio
        is_known = abs(ratio) > LEAST_RATIO
        step = (observation.encoder_mm - last.encoder_mm) / (ratio if is_known else 1.0)
        elapsed = observation.clock - last.clock
        is_travel = abs(step) <= FASTEST_MM_S * elapsed
        by_speed = (step if is_travel else 0.0) if self.speed is None else self.speed * elapsed
        if not is_travel:  # a reading that no belt can follow says nothing about how far this one moved
            step = by_speed
        # nor can the belt have left its speed by more than it accelerates since it was seen
        since = max(observation.clock - self._observed_clock, elapsed)
        reach = _NEGLIGIBLE_MM + _HIGHEST_ACCELERATION_MM_S2 * since * elapsed
        step = float(np.clip(step, by_speed - reach, by_speed + reach))
        differs = not is_known or abs(step - by_speed) > MAX_DISAGREEMENT * abs(by_speed) + _NEGLIGIBLE_MM
        sigma = float(np.hypot(abs(step - by_speed) / np.sqrt(12), _SPEED_CHANGE * by_speed))
        if differs and observation.clock - self._observed_clock < _LONGEST_COAST:
            step = by_speed
        elif differs:
            step = float(np.clip(step, 0.0, max(by_speed, 0.0)))
        return self._make_position(last.position_mm + step, sigma, "speed", observation)

    def _from_speed(self, observation: MotionObservation) -> BeltPosition | None:
        last = self.last
        if last is None or self.speed is None:
            return None
        elapsed = observation.clock - last.clock
        step = self.speed * elapsed
        grown = last.sigma_mm if last.source == "speed" else 0.0
        sigma = float(
            np.hypot(grown, abs(step) * np.hypot(_SPEED_KNOWN, _SPEED_CHANGE * np.sqrt(max(elapsed, 0))))
        )
        return self._make_position(last.position_mm + step, sigma, "speed", observation)

    @staticmethod
    def _make_position(
        position_mm: float, sigma_mm: float, source: Source, observation: MotionObservation
    ) -> BeltPosition:
        return BeltPosition(position_mm, sigma_mm, source, observation.clock, observation.encoder_mm)


def _select_more_certain(
    by_material: BeltPosition | None, by_encoder: BeltPosition | None
) -> BeltPosition | None:
    """Return the position with the smaller σ of those that are known.

    A nearly even load shows its motion to millimetres only, a trusted encoder to tenths of one.
    """
    if by_material is None or by_encoder is None:
        return by_material or by_encoder
    return by_encoder if by_encoder.sigma_mm < by_material.sigma_mm else by_material
