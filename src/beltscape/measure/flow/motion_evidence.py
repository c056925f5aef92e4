"""Evidence from the material's motion for the belt's direction and the encoder's scale, counted in frame pairs."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from beltscape.measure.flow.belt_motion import MAX_DISAGREEMENT
from beltscape.measure.flow.registration import Shift

LEAST_MM = 2.0
"""A shorter motion is no evidence, since encoder jitter and registration errors reach tenths of it."""
LEAST_PAIRS = 3
"""Least number of frame pairs for a contradiction: one wrong registration must not reject an encoder."""
_SIGMAS = 4.0
"""A motion counts if it exceeds this many σ of its registration."""
_REMEMBERED = 64
"""Number of latest pairs whose ratios are kept for the median."""


@dataclass(slots=True)
class Ratios:
    """The latest frame pairs' encoder steps over the material's; bounded in memory."""

    _values: deque[float] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))

    def add(self, ratio: float) -> None:
        """Add a pair's ratio."""
        self._values.append(ratio)

    @property
    def median(self) -> float:
        """Return the median ratio; NaN without pairs."""
        return float(np.median(self._values)) if self._values else float("nan")

    @property
    def spread(self) -> float:
        """Return the relative median deviation: small for a wrong unit, large for accidental matches."""
        median = self.median
        if not self._values or median == 0:
            return float("nan")
        return float(np.median(np.abs(np.array(self._values) / median - 1)))


@dataclass(slots=True)
class MotionEvidence:
    """Counts of the frame pairs in which the material was recognised and it, or the encoder, moved.

    Only unambiguous registrations count, not those selected by a given direction or a predicted motion.
    """

    plus: int = 0
    """Pairs in which the material moved towards +y."""
    minus: int = 0
    """Pairs in which it moved towards -y."""
    still: int = 0
    """Pairs in which it stood still and the encoder did not."""
    agreeing: int = 0
    """Pairs in which material and encoder agree within `MAX_DISAGREEMENT`."""
    opposite: int = 0
    """Pairs in which the material moved against the direction in which the encoder counts."""
    encoder_still: int = 0
    """Pairs in which the material moved and the encoder hardly did: it stood still, or counts in a larger unit."""
    other_scale: int = 0
    """Pairs in which both moved the same way by different lengths."""
    by_encoder: int = 0
    """Conflicting pairs whose motion was taken from the encoder: what was registered is not surely the material's."""
    apart: int = 0
    """Pairs that by the encoder do not overlap, although their material was registered: it may be similar other
    material, unless the ratios are consistent."""
    ratios: Ratios = field(default_factory=Ratios)
    """Ratios of the pairs in which the material moved, except those ``apart``."""
    apart_ratios: Ratios = field(default_factory=Ratios)
    """Ratios of the pairs ``apart``."""

    def add_apart(self, shift: Shift, direction: int, encoder_step_mm: float) -> None:
        """Count a frame pair whose two views, by the encoder, do not overlap; the lengths are as in `add`."""
        if shift.clear and abs(shift.along_mm) > _compute_least_mm(shift):
            self.apart += 1
            self.apart_ratios.add(direction * encoder_step_mm / shift.along_mm)

    def add(self, shift: Shift, direction: int, encoder_step_mm: float | None) -> None:
        """Count a frame pair; ``encoder_step_mm`` is the raw encoder's, positive along the travel ``direction``."""
        if not shift.clear:
            return
        least = _compute_least_mm(shift)
        moved = abs(shift.along_mm) > least
        self.plus += moved and shift.along_mm > 0
        self.minus += moved and shift.along_mm < 0
        if encoder_step_mm is not None:
            self._compare(shift.along_mm, direction * encoder_step_mm, least)

    def _compare(self, along_mm: float, encoder_mm: float, least_mm: float) -> None:
        """Compare encoder and material, both positive towards +y, and count the result."""
        moved = abs(along_mm) > least_mm
        if not moved and abs(encoder_mm) <= least_mm:
            return
        if moved:
            self.ratios.add(encoder_mm / along_mm)
        if abs(along_mm - encoder_mm) <= MAX_DISAGREEMENT * abs(encoder_mm) + least_mm:
            self.agreeing += 1
        elif not moved:
            self.still += 1
        elif encoder_mm * along_mm < 0:
            self.opposite += 1
        elif abs(encoder_mm) <= least_mm:
            self.encoder_still += 1
        else:
            self.other_scale += 1

    @property
    def moving(self) -> int:
        """Return the number of pairs in which the material moved."""
        return self.plus + self.minus

    @property
    def compared(self) -> int:
        """Return the number of pairs in which material and encoder were compared."""
        return self.agreeing + self.conflicting

    @property
    def conflicting(self) -> int:
        """Return the number of pairs in which the encoder contradicts the material."""
        return self.opposite + self.still + self.encoder_still + self.other_scale

    def along(self, direction: int) -> int:
        """Return the number of pairs in which the material moved in ``direction`` (+1 or -1)."""
        return self.plus if direction > 0 else self.minus


def _compute_least_mm(shift: Shift) -> float:
    """Return the least length that is a motion."""
    return LEAST_MM + _SIGMAS * shift.sigma_mm
