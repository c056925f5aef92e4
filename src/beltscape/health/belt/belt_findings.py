"""Findings about material stuck to the belt, and about splices and torn edges."""

from __future__ import annotations

from collections.abc import Iterable

from beltscape.core.live.findings import Finding
from beltscape.core.live.translatable_message import Message
from beltscape.health.belt.beside_load import BesideLoad
from beltscape.health.belt.passes import BeltEvent, BeltPasses
from beltscape.health.belt.settings import BeltLimits

CARRY_BACK, CARRY_BACK_TOTAL, STUCK_TOTAL = "carry_back", "carry_back_total", "carry_back_stuck"
_NAN = float("nan")
_MM3_PER_L = 1e6
"""mm³ of a litre."""
_CHECKS = {"splice": "splice", "torn left edge": "torn_edge_left", "torn right edge": "torn_edge_right"}


def make_carry_back_findings(
    residue: tuple[float, float], passes: BeltPasses, limits: BeltLimits
) -> tuple[Finding, ...]:
    """Return the cross-section of ``residue`` (value and σ, mm²) and the totals on otherwise empty belt.

    The material is part of the flow's records each time that it passes; the totals state how much of these it is.
    """
    area, sigma = residue
    limit = limits.carry_back_mm2
    is_fault = area > limit and area > limits.zero_sigmas * sigma
    text = Message(
        f"{area / 100:.1f} ± {sigma / 100:.1f} cm² of material on the empty belt: "
        "check the scraper; what returns with the belt is counted in every revolution",
        "carry_back",
        area=round(area / 100, 1),
        sigma=round(sigma / 100, 1),
    )
    totals = [Finding(CARRY_BACK_TOTAL, passes.residue_mm3 / _MM3_PER_L, _NAN, _NAN, "l")]
    if limits.belt_length_m is not None:
        totals.append(Finding(STUCK_TOTAL, passes.stuck_mm3 / _MM3_PER_L, _NAN, _NAN, "l"))
    return (Finding(CARRY_BACK, area, sigma, limit, "mm²", text=text if is_fault else ""), *totals)


def make_beside_finding(
    beside: BesideLoad, zero_sigma_mm: float, width_mm: float, limits: BeltLimits
) -> Finding | None:
    """Return the finding "carry_back" of what lies beside a load, as a cross-section of the whole width.

    None: it was not seen, or is no more than the limit. The records of the load hold it: they are degraded, and σ
    covers the strips' part of the mean height.
    """
    area, sigma = beside.thickness_mm * width_mm, zero_sigma_mm * width_mm
    limit = limits.carry_back_mm2
    if not (area > limit and area > limits.zero_sigmas * sigma):
        return None
    text = Message(
        f"{beside.thickness_mm:.1f} ± {zero_sigma_mm:.1f} mm of material on the belt on both sides of the load: "
        "check the scraper, and whether the load lies too wide; the records hold it",
        "carry_back_beside",
        thickness=round(beside.thickness_mm, 1),
        sigma=round(zero_sigma_mm, 1),
    )
    systematic = beside.thickness_mm * min(beside.strip_mm / width_mm, 1.0)
    return Finding(
        CARRY_BACK, area, sigma, limit, "mm²", text=text, effect="degraded", systematic_mm=systematic
    )


def make_event_findings(events: Iterable[BeltEvent], side_mm: float) -> tuple[Finding, ...]:
    """Return the position, in m along the belt, of each splice and torn edge that passed; a torn edge is a fault.

    It degrades its frame where a load lay beside it: some may have fallen through, and the ground shows in the notch.
    """
    out: list[Finding] = []
    for event in events:
        text = Message(
            f"{event.kind} of the belt at {event.position_mm / 1000:.2f} m: {event.size_mm:.0f} mm deep, "
            f"{event.length_mm:.0f} mm long; inspect it there",
            "torn_edge",
            position=round(event.position_mm / 1000, 2),
            depth=round(event.size_mm),
            length=round(event.length_mm),
        )
        is_fault = event.kind != "splice"
        sigma = side_mm / 2000
        out.append(
            Finding(
                _CHECKS[event.kind],
                event.position_mm / 1000,
                sigma,
                _NAN,
                "m",
                text=text if is_fault else "",
                effect="degraded" if is_fault and event.is_loaded else "none",
                is_momentary=True,
            )
        )
    return tuple(out)
