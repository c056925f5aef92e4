"""The check of the encoder against the material: contradictions, and when the encoder is trusted again."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Literal

import numpy as np

from beltscape.core.alarm_catalogue import ENCODER_MOTION
from beltscape.core.findings import Finding
from beltscape.core.translatable_message import make_message
from beltscape.measure.flow.belt_motion import BeltPosition

Kind = Literal["still", "standing", "reversed", "scale", "jump", "unmatched", "silent", "resumed"]
"""What contradicts the encoder:

still      the material moves, the encoder does not
standing   the encoder moves, the material does not
reversed   both move, in opposite directions
scale      both move the same way by different lengths: slip, or a wrong scale
jump       no belt changes its speed as fast as the encoder's reading
unmatched  the material is not where the encoder predicts it, and its motion is unknown
silent     the encoder gave readings and gives none any more
resumed    after a standstill on an empty belt the reading is as far ahead as if the belt had gone on
"""
LEAST_MM = 2.0
"""Smaller differences are no contradiction: resolution, play of the wheel, and jitter of both readings."""
_TIMING_S = 0.002
"""Encoder and images may be read at instants that differ by this much."""
_SIGMAS = 4.0
"""A difference counts if it exceeds this many σ of the registration, so that a sound encoder is not distrusted."""
_HISTORY = 128
"""Number of intervals over which small differences add up."""
_LEAST_AGREEING = 3
"""Number of agreeing intervals after which the encoder is trusted again; one may agree by chance."""
_TREND_MM = 5000.0
"""Length of belt over which the present ratio is averaged: some seconds, within which slip is to be noticed."""
_LEAST_TREND_MM = 100.0
"""Least length of belt for a present ratio: over it, `LEAST_MM` at both ends makes 3 %. Chosen."""
_CONSTANT_RATIO = 0.03
"""Relative spread of the ratios below which an encoder slips or has a wrong scale; wild readings spread by more."""
_SCALE_SIGMA = 0.0002
"""σ of the length that a calibrated rig measures: on rendered heaps encoder and material differ by up to 0.0003."""
_STANDING_SHARE = 0.05
"""An encoder that moves by less than this share of the material's travel stands still, and jitters."""


@dataclass(frozen=True, slots=True)
class Interval:
    """Travel of encoder and material between two frames."""

    encoder_mm: float
    material_mm: float
    variance_mm2: float
    """Variance of the material's travel."""
    first: int
    """Number of the frame after which it begins."""
    common_mm: float = 0.0
    """σ of the part of the error that the intervals have in common."""


@dataclass(frozen=True, slots=True)
class Contradiction:
    """A contradiction between encoder and material."""

    kind: Kind
    first: int
    """Number of the first frame that it concerns."""
    value: float
    """Travel of the encoder over that of the material, less 1; NaN where the material's is unknown."""
    sigma: float
    intervals: int = 1
    """Number of intervals that it took to notice it."""


class EncoderCheck:
    """Compares the travel of encoder and material over the latest intervals; bounded in memory."""

    def __init__(self, tolerance: float) -> None:
        """``tolerance`` is the relative difference that counts as agreement."""
        self.tolerance = tolerance
        self.contradiction: Contradiction | None = None
        """The last contradiction while the encoder is not trusted."""
        self._agreed = -1
        """Number of the last frame in which encoder and material agreed."""
        self._needed = 0
        self._intervals: deque[Interval] = deque(maxlen=_HISTORY)
        self._trend: deque[Interval] = deque(maxlen=4 * _HISTORY)

    @property
    def agreed(self) -> int:
        """Return the number of the last frame in which encoder and material agreed; -1 before."""
        return self._agreed

    @property
    def is_trusted(self) -> bool:
        """Return whether the encoder agrees with the material as far as both are known."""
        return self._needed == 0

    def find_contradiction(self, now: Interval, number: int, speed: float) -> Contradiction | None:
        """Return the contradiction of the interval that ends with frame ``number``, alone or with those before it.

        It concerns the frames since the last agreement, or since the beginning of these intervals.
        """
        encoder, material, variance = 0.0, 0.0, 0.0
        allowed = LEAST_MM + _TIMING_S * abs(speed)
        for count, one in enumerate((now, *reversed(self._intervals)), 1):
            encoder += one.encoder_mm
            material += one.material_mm
            variance += one.variance_mm2
            difference = abs(encoder - material)
            if difference > allowed + _SIGMAS * variance**0.5 + self.tolerance * abs(material):
                first = 1 + min(one.first, self._agreed)
                return make_contradiction(encoder, material, variance, first=first, intervals=count)
        if abs(now.material_mm) > LEAST_MM:
            self._agreed = number
        return None

    def distrust(self, contradiction: Contradiction) -> None:
        """Reject the encoder until enough intervals agree, as many as it took to notice the contradiction, twice."""
        if self.is_trusted:
            self._trend.clear()
        self.contradiction = contradiction
        self._needed = max(_LEAST_AGREEING, 2 * contradiction.intervals)
        self._intervals.clear()

    def close(self, interval: Interval, *, agrees: bool) -> bool:
        """Add a finished interval; return whether the encoder is trusted again since then."""
        self._trend.append(interval)
        length = sum(abs(one.material_mm) for one in self._trend)
        while len(self._trend) > 1 and length - abs(self._trend[0].material_mm) >= _TREND_MM:
            length -= abs(self._trend.popleft().material_mm)
        if not agrees:
            return False
        self._intervals.append(interval)
        return abs(interval.material_mm) > LEAST_MM and self.count_agreement()

    def count_agreement(self) -> bool:
        """Count an agreement while the encoder is not trusted; return whether it is trusted again."""
        if self.is_trusted:
            return False
        self._needed -= 1
        if self.is_trusted:
            self.contradiction = None
            self._trend.clear()
            self._trend.extend(self._intervals)
        return self.is_trusted

    @property
    def constant_ratio(self) -> float:
        """Return the median of encoder over material of the last intervals; NaN where it is not constant."""
        ratios = [one.encoder_mm / one.material_mm for one in self._trend if abs(one.material_mm) > LEAST_MM]
        if len(ratios) < _LEAST_AGREEING:
            return float("nan")
        ratio = float(np.median(ratios))
        spread = float(np.median(np.abs(np.array(ratios) - ratio)))
        return ratio if spread <= _CONSTANT_RATIO * abs(ratio) else float("nan")

    @property
    def deviation(self) -> tuple[float, float]:
        """Return encoder over material less 1 over the last metres, and its σ; NaN before enough travel."""
        encoder = sum(one.encoder_mm for one in self._trend)
        material = sum(one.material_mm for one in self._trend)
        if abs(material) < _LEAST_TREND_MM:
            return float("nan"), float("nan")
        variance = sum(one.variance_mm2 for one in self._trend)
        common = sum(one.common_mm for one in self._trend) / abs(material)
        sigma = np.hypot(_compute_sigma(encoder, material, variance), np.hypot(common, _SCALE_SIGMA))
        return encoder / material - 1, float(sigma)


def make_contradiction(
    encoder_mm: float, material_mm: float, variance_mm2: float, *, first: int, intervals: int
) -> Contradiction:
    """Return the contradiction of travels of encoder and material over some intervals."""
    return Contradiction(
        _classify(encoder_mm, material_mm),
        first,
        _compute_deviation(encoder_mm, material_mm),
        _compute_sigma(encoder_mm, material_mm, variance_mm2),
        intervals,
    )


def _compute_deviation(encoder_mm: float, material_mm: float) -> float:
    """Return encoder over material less 1, limited to ±100 for a material that stands still."""
    if abs(material_mm) < 1e-2 * abs(encoder_mm):
        return 100.0 if encoder_mm > 0 else -100.0
    return encoder_mm / material_mm - 1


def _compute_sigma(encoder_mm: float, material_mm: float, variance_mm2: float) -> float:
    """Return σ of encoder over material from the material's variance and the encoder's play at both ends."""
    length = max(abs(material_mm), 1e-2 * abs(encoder_mm), 1.0)
    return float(np.sqrt(variance_mm2 + 2 * (LEAST_MM / _SIGMAS) ** 2) / length)


def _classify(encoder_mm: float, material_mm: float) -> Kind:
    if abs(encoder_mm) <= max(_STANDING_SHARE * abs(material_mm), LEAST_MM):
        return "still"
    if abs(material_mm) <= LEAST_MM:
        return "standing"
    return "reversed" if encoder_mm * material_mm < 0 else "scale"


_SLIP = 0.002
"""Slow slip that is named although it is within the tolerance: calibrated rigs measure lengths within 0.0005."""
_SURE_SIGMAS = 3.0
"""Number of σ by which slip must differ from 0 to be named; most of σ is a bias, not noise with its tails."""
_NAN = float("nan")


def make_encoder_finding(check: EncoderCheck, before: BeltPosition | None, place: BeltPosition) -> Finding:
    """Return the finding of a frame at a position; ``before`` is that of the frame before."""
    is_measured = place.source == "material"
    step = 0.0 if before is None else abs(place.position_mm - before.position_mm)
    relative_sigma = min(1.0, place.sigma_mm / max(step, 1.0))
    contradiction = check.contradiction
    if contradiction is None:
        value, sigma = check.deviation if is_measured else (_NAN, _NAN)
        return Finding(ENCODER_MOTION, value, sigma, check.tolerance, "", text=_describe_slip(value, sigma))
    value, sigma = check.deviation
    if math.isnan(value):  # too few intervals since the contradiction
        value, sigma = contradiction.value, contradiction.sigma
    source = "the material" if is_measured else "the material's last speed"
    return Finding(
        ENCODER_MOTION,
        value,
        sigma,
        check.tolerance,
        "",
        text=make_message(f"encoder_{contradiction.kind}", detail=f"the metres are counted by {source}"),
        effect="degraded",
        relative_sigma=0.0 if is_measured else relative_sigma,
    )


def make_stall_finding(encoder_mm: float, tolerance: float) -> Finding:
    """Return the finding of a frame that shows the material where it was, while the encoder counted ``encoder_mm``.

    Either the images repeat, or the belt stands and the encoder is wrong: the frame is not measured, and its belt is
    missing unless other frames show it.
    """
    text = make_message("encoder_stalled", metres=round(encoder_mm / 1000, 2))
    return Finding(ENCODER_MOTION, 100.0, _NAN, tolerance, "", text=text, effect="missing", is_momentary=True)


def _describe_slip(value: float, sigma: float) -> str:
    """Return the text of slow slip, which harms no record as long as it is within the tolerance."""
    if not abs(value) > max(_SLIP, _SURE_SIGMAS * sigma):
        return ""
    return make_message("encoder_slip", slip=round(100 * value, 2), sigma=round(100 * sigma, 2))
