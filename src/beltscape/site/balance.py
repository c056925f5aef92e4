"""The balance over a transfer point: what belts bring to it against what belts take away, within a window of time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from beltscape.site.catch_up import FIELDS, GapReason, RecordSums
from beltscape.site.settings import BalanceSettings

BalanceState = Literal["balanced", "imbalance", "incomplete"]
"""Within the limit; beyond it; or not known, since a belt was not measured throughout."""
_EDGE_S = 5.0
"""Half of the time over which the flow at an edge of a window is averaged. Chosen: longer than a record."""


@dataclass(frozen=True, slots=True)
class BalanceResult:
    """The balance of one window; amounts in t or m³, as the balance compares masses or volumes."""

    start_ms: int
    """Beginning of the window, by the time at the transfer point."""
    end_ms: int
    state: BalanceState
    inflow: float | None
    """None where it is not known."""
    outflow: float | None
    sigma: float | None
    """One standard deviation of inflow − outflow."""
    reason: str = ""
    """Why it is incomplete: the reason of a gap, "unmeasured" or "density"; empty otherwise."""
    belt: str = ""
    """The belt of this reason."""


@dataclass(frozen=True, slots=True)
class BeltWindow:
    """Sums of what passed on one belt within a window that is shifted by the belt's delay."""

    belt: str
    sums: RecordSums
    change_m3_s: float
    """Volume flow at the end of the window minus that at its beginning."""
    gap: GapReason | None
    """A gap that reaches into the window; None: there is none."""


def shift_window(settings: BalanceSettings, belt: str, start_ms: int, end_ms: int) -> tuple[int, int]:
    """Return when what passes the transfer point within a window passes a belt's measuring place."""
    delay_ms = round(settings.delay_s.get(belt, 0.0) * 1000)
    shift = -delay_ms if belt in settings.inflow else delay_ms
    return start_ms + shift, end_ms + shift


def sum_window(seconds: Mapping[int, RecordSums], start_ms: int, end_ms: int) -> tuple[RecordSums, float]:
    """Return the sums of a window and the change of the volume flow over it, m³/s.

    ``seconds`` reach at least 10 s beyond both ends; a second that an end cuts counts by its share.
    """
    total = RecordSums()
    for second, sums in seconds.items():
        share = min(end_ms, second * 1000 + 1000) - max(start_ms, second * 1000)
        if share >= 1000:
            total += sums
        elif share > 0:
            total += _scale(sums, share / 1000)
    return total, _compute_flow(seconds, end_ms) - _compute_flow(seconds, start_ms)


def _scale(sums: RecordSums, share: float) -> RecordSums:
    return RecordSums(*(getattr(sums, name) * share for name in FIELDS))


def _compute_flow(seconds: Mapping[int, RecordSums], at_ms: int) -> float:
    """Return the mean volume flow around a time, m³/s."""
    half = round(_EDGE_S)
    first = round(at_ms / 1000) - half
    return sum(seconds[s].volume_m3 for s in range(first, first + 2 * half) if s in seconds) / (2 * _EDGE_S)


def compute_balance(
    settings: BalanceSettings, window_ms: tuple[int, int], belts: Sequence[BeltWindow]
) -> BalanceResult:
    """Return the balance of a window.

    The belts are measured by machines of their own, so that their errors are independent: σ adds in squares, with
    the error of the delays (it shifts a window, which matters where the flow changes) and ``relative_sigma``.
    """
    if fault := _find_fault(settings, belts):
        return BalanceResult(*window_ms, "incomplete", None, None, None, *fault)
    inflow = sum(_get_amount(settings, one) for one in belts if one.belt in settings.inflow)
    outflow = sum(_get_amount(settings, one) for one in belts if one.belt in settings.outflow)
    variance = ((inflow + outflow) / 2 * settings.relative_sigma) ** 2
    for one in belts:
        density = _get_density(settings, one)
        variance += (one.sums.sigma_m3 * density) ** 2
        variance += (one.change_m3_s * density * settings.delay_sigma_s) ** 2
    sigma = math.sqrt(variance)
    is_beyond = abs(inflow - outflow) > settings.sigmas * sigma
    return BalanceResult(*window_ms, "imbalance" if is_beyond else "balanced", inflow, outflow, sigma)


def _find_fault(settings: BalanceSettings, belts: Sequence[BeltWindow]) -> tuple[str, str] | None:
    """Return why a window is incomplete, and the belt; None where it is complete."""
    for one in belts:
        if one.gap is not None:
            return one.gap, one.belt
        if one.sums.missing_m > settings.missing_share * one.sums.length_m:
            return "unmeasured", one.belt
        if settings.quantity == "mass" and one.sums.unweighed_m3 != 0:
            return "density", one.belt
    return None


def _get_amount(settings: BalanceSettings, one: BeltWindow) -> float:
    return one.sums.mass_t if settings.quantity == "mass" else one.sums.volume_m3


def _get_density(settings: BalanceSettings, one: BeltWindow) -> float:
    """Return the factor from a volume, m³, to the amount that is compared."""
    if settings.quantity == "volume":
        return 1.0
    return one.sums.mass_t / one.sums.volume_m3 if one.sums.volume_m3 > 0 else 0.0
