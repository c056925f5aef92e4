"""Findings about the zero: the shift and the tilt of the bare belt in a frame, and their average over frames.

In the average slow drifts become significant below the noise of one frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from beltscape.core.alarm_catalogue import ZERO_DRIFT, ZERO_SHIFT, ZERO_TILT
from beltscape.core.findings import Finding
from beltscape.core.translatable_message import make_message
from beltscape.health.belt.zero_shift import ZeroShift
from beltscape.health.settings import BeltLimits

_MEMORY = 0.98
"""Weight that a frame keeps after the next one: the average covers about 50 frames."""
_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class ZeroHistory:
    """The average shift of the zero over the last frames that showed bare belt."""

    offset_mm: float = _NAN
    """NaN: bare belt was never visible."""
    common_mm: float = 0.0
    """Part of σ that does not average out over frames."""
    weight: float = 0.0
    """Sum of the frames' weights 1/σ², 1/mm²."""
    scatter_mm2: float = 0.0
    """Mean square of the frames' deviations from the average."""
    frames_without: int = 0
    """Frames since bare belt was last visible."""

    @property
    def sigma_mm(self) -> float:
        """Return one standard deviation of the average, as a statement about the present frame."""
        if not self.weight:
            return _NAN
        wander = self.scatter_mm2 * (1 - _MEMORY) * (1 + self.frames_without)
        return float(np.sqrt(self.common_mm**2 + 1 / self.weight + wander))


def update_zero_history(history: ZeroHistory, shift: ZeroShift, jump_mm: float) -> ZeroHistory:
    """Return the history with the next frame; a jump beyond ``jump_mm`` and its σ starts it anew."""
    if not shift.is_measured:
        return ZeroHistory(
            history.offset_mm,
            history.common_mm,
            history.weight,
            history.scatter_mm2,
            history.frames_without + 1,
        )
    variance = max(shift.sigma_mm**2 - shift.common_mm**2, 1e-8)
    change = shift.offset_mm - history.offset_mm
    if not history.weight or abs(change) > jump_mm + 4 * shift.sigma_mm:
        return ZeroHistory(shift.offset_mm, shift.common_mm, 1 / variance)
    kept = _MEMORY * history.weight
    part = 1 / (variance * kept + 1)
    return ZeroHistory(
        history.offset_mm + part * change,
        max(shift.common_mm, _MEMORY * history.common_mm),
        kept + 1 / variance,
        _MEMORY * history.scatter_mm2 + (1 - _MEMORY) * change**2,
    )


_TILT_SHARES = np.array([0.1, 0.35, 0.1, 0.2])
"""Standard deviation of a strip's mean height by tilt across, tilt along, lateral shift and yaw, as a share of the
rise at the edge: hidden parts are not spread evenly, and a strip is not seen equally often at both ends of the view
(one degree along: 0.2 to 0.3 on three simulated loads)."""
_SUNK_PX, _SUNK_FACTOR = 2.0, 1.5
"""A belt that sank by more than this many pixels: the meter takes parts of it for mismatches, which makes holes. On
three simulated loads the error grows by up to this factor."""


def make_zero_findings(
    shift: ZeroShift, history: ZeroHistory, before: ZeroHistory, pixel_mm: float, limits: BeltLimits
) -> tuple[Finding, ...]:
    """Return the findings of a frame; ``history`` includes it, ``before`` does not; ``pixel_mm`` is on the belt."""
    rise, rise_sigma = find_largest_tilt(shift)
    return (
        _make_shift_finding(shift, before, pixel_mm, limits),
        _make_drift_finding(shift, history, limits),
        _make_tilt_finding(rise, rise_sigma, limits),
    )


def find_largest_tilt(shift: ZeroShift) -> tuple[float, float]:
    """Return the largest rise of an edge or end of the view by tilt or lateral shift, and its σ; NaN if unknown."""
    if not shift.is_measured:
        return _NAN, _NAN
    sigma = np.sqrt(np.diag(shift.covariance_mm2))
    largest = 1 + int(np.argmax(np.abs(shift.motion_mm[1:])))
    return float(shift.motion_mm[largest]), float(sigma[largest])


def _make_shift_finding(
    shift: ZeroShift, before: ZeroHistory, pixel_mm: float, limits: BeltLimits
) -> Finding:
    if not shift.is_measured:
        return Finding(ZERO_SHIFT, _NAN, _NAN, limits.zero_mm, "mm")
    tilts = _TILT_SHARES * shift.motion_mm[1:]
    systematic = float(np.sqrt(shift.offset_mm**2 + shift.sigma_mm**2 + np.sum(tilts**2)))
    if shift.offset_mm < -_SUNK_PX * pixel_mm:
        systematic *= _SUNK_FACTOR
    is_fault = _exceeds(shift.offset_mm, shift.sigma_mm, limits.zero_mm, limits)
    return Finding(
        ZERO_SHIFT,
        shift.offset_mm,
        shift.sigma_mm,
        limits.zero_mm,
        "mm",
        text=_describe(shift, before, limits) if is_fault else "",
        effect="degraded" if is_fault else "none",
        systematic_mm=systematic,
    )


def _make_drift_finding(shift: ZeroShift, history: ZeroHistory, limits: BeltLimits) -> Finding:
    """Return the finding of the average; where the frame shows no bare belt, it stands for the frame."""
    offset, sigma = history.offset_mm, history.sigma_mm
    known = bool(history.weight)
    is_fault = known and _exceeds(offset, sigma, limits.zero_mm, limits)
    text = make_message("zero_drift", offset=round(offset, 2), sigma=round(sigma, 2))
    return Finding(
        ZERO_DRIFT,
        offset,
        sigma,
        limits.zero_mm,
        "mm",
        text=text if is_fault else "",
        effect="degraded" if is_fault else "none",
        systematic_mm=float(np.hypot(offset, sigma)) if known and not shift.is_measured else 0.0,
    )


def _make_tilt_finding(rise_mm: float, sigma_mm: float, limits: BeltLimits) -> Finding:
    is_fault = _exceeds(rise_mm, sigma_mm, limits.tilt_mm, limits)
    text = make_message("zero_tilt", rise=round(abs(rise_mm), 1))
    return Finding(
        ZERO_TILT,
        abs(rise_mm),
        sigma_mm,
        limits.tilt_mm,
        "mm",
        text=text if is_fault else "",
        effect="degraded" if is_fault else "none",
    )


def _exceeds(value: float, sigma: float, limit: float, limits: BeltLimits) -> bool:
    return bool(abs(value) > limit and abs(value) > limits.zero_sigmas * sigma)


def classify_shift(
    shift: ZeroShift, before: ZeroHistory, limits: BeltLimits
) -> Literal["moved", "moved on one side", "worn", "film"]:
    """Return what a shift looks like: a sudden rigid motion, one that only one strip shows, wear, or a film."""
    is_sudden = not before.weight or abs(shift.offset_mm - before.offset_mm) > 0.5 * limits.zero_mm
    if not min(shift.sides):
        return "moved on one side"
    if is_sudden:
        return "moved"
    return "film" if shift.offset_mm > 0 else "worn"


def _describe(shift: ZeroShift, before: ZeroHistory, limits: BeltLimits) -> str:
    kind = classify_shift(shift, before, limits).replace(" ", "_")
    return make_message(f"zero_{kind}", offset=round(shift.offset_mm, 2), sigma=round(shift.sigma_mm, 2))
