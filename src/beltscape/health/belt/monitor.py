"""The checks of heights over a sequence of frames, and their findings about carry-back, splices and torn edges."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from beltscape.core.alarm_catalogue import (
    CARRY_BACK,
    CARRY_BACK_STUCK,
    CARRY_BACK_TOTAL,
    SPLICE,
    TORN_EDGE_LEFT,
    TORN_EDGE_RIGHT,
)
from beltscape.core.depth import DepthMap
from beltscape.core.findings import Finding
from beltscape.core.translatable_message import make_message
from beltscape.health.belt.cells import compute_belt_cells
from beltscape.health.belt.passes import BeltEvent, BeltPasses
from beltscape.health.belt.residue import BesideLoad, CellRows, arrange_rows, measure_residue
from beltscape.health.belt.splices import find_splice
from beltscape.health.belt.zero_finding import ZeroHistory, make_zero_findings, update_zero_history
from beltscape.health.belt.zero_shift import ZeroShift, estimate_zero_shift, make_unmeasured_shift
from beltscape.health.settings import BeltLimits
from beltscape.measure.belt.reference import EmptyBeltReference

_NAN = float("nan")
_MM3_PER_L = 1e6
"""mm³ of a litre."""
_CHECKS = {"splice": SPLICE, "torn left edge": TORN_EDGE_LEFT, "torn right edge": TORN_EDGE_RIGHT}


def make_carry_back_findings(
    residue: tuple[float, float], passes: BeltPasses, limits: BeltLimits
) -> tuple[Finding, ...]:
    """Return the cross-section of ``residue`` (value and σ, mm²) and the totals on otherwise empty belt.

    The material is part of the flow's records each time that it passes; the totals state how much of these it is.
    """
    area, sigma = residue
    limit = limits.carry_back_mm2
    is_fault = area > limit and area > limits.zero_sigmas * sigma
    text = (
        make_message("carry_back", area=round(area / 100, 1), sigma=round(sigma / 100, 1)) if is_fault else ""
    )
    totals = [Finding(CARRY_BACK_TOTAL, passes.residue_mm3 / _MM3_PER_L, _NAN, _NAN, "l")]
    if limits.belt_length_m is not None:
        totals.append(Finding(CARRY_BACK_STUCK, passes.stuck_mm3 / _MM3_PER_L, _NAN, _NAN, "l"))
    return (Finding(CARRY_BACK, area, sigma, limit, "mm²", text=text), *totals)


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
    text = make_message(
        "carry_back_beside", thickness=round(beside.thickness_mm, 1), sigma=round(zero_sigma_mm, 1)
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
        text = make_message(
            "torn_edge",
            subject=event.kind.removeprefix("torn "),
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


@dataclass(frozen=True, slots=True, eq=False)
class BareBeltHeights:
    """The bare belt in one depth map, against the learned one."""

    shift: ZeroShift
    rows: CellRows | None
    """Its cells in rows; None: no bare belt is visible."""
    residue: tuple[float, float]
    """Cross-section of what is stuck to it, and its σ, mm²; NaN where it is not measured."""


def measure_bare_belt(depth: DepthMap, reference: EmptyBeltReference, limits: BeltLimits) -> BareBeltHeights:
    """Return the bare belt in a depth map; it depends on the depth map only."""
    cells = compute_belt_cells(depth, reference)
    shift = estimate_zero_shift(cells, reference.belt, reference.cell_mm, limits.search_mm)
    if not shift.is_measured:
        return BareBeltHeights(shift, None, (_NAN, _NAN))
    rows = arrange_rows(cells, shift)
    return BareBeltHeights(shift, rows, measure_residue(rows, shift))


class BeltMonitor:
    """Compares the bare belt of each frame with the learned one, and follows what is stuck to it."""

    def __init__(self, reference: EmptyBeltReference, limits: BeltLimits | None = None) -> None:
        self._reference, self.limits = reference, limits or BeltLimits()
        self._history = ZeroHistory()
        self._rows: CellRows | None = None
        self._residue = (_NAN, _NAN)
        self._zero_sigma_mm = _NAN
        self._beside: tuple[Finding, ...] = ()
        """What lay beside the load by the last `follow`, for the records of the next frame."""
        self._passes: BeltPasses | None = None

    @property
    def history(self) -> ZeroHistory:
        """Return the average shift of the zero, the correction that setting it would make."""
        return self._history

    def check(self, depth: DepthMap | None, measured: BareBeltHeights | None = None) -> tuple[Finding, ...]:
        """Return the findings of the next frame, before it is measured; None for a frame without a depth map.

        ``measured`` is the result of `measure_bare_belt` for it, where it is known.
        """
        if not self.limits.enabled:
            return ()
        shift, before = make_unmeasured_shift(0), self._history
        self._rows, self._residue = None, (_NAN, _NAN)
        if depth is not None:
            bare = measured or measure_bare_belt(depth, self._reference, self.limits)
            shift, self._rows, self._residue = bare.shift, bare.rows, bare.residue
            if shift.is_measured:
                self._zero_sigma_mm = shift.sigma_mm
        self._history = update_zero_history(before, shift, 0.5 * self.limits.zero_mm)
        zero = make_zero_findings(shift, self._history, before, self._reference.cell_mm, self.limits)
        return (*zero, *self._beside)

    def follow(self, position_mm: float | None, direction: int) -> tuple[Finding, ...]:
        """Return the findings about carry-back, splices and edges in the frame of the last `check`.

        ``position_mm`` is the belt's position at it; None: not known, then nothing is followed.
        """
        if self._rows is None or position_mm is None:
            return ()
        length_m = self.limits.belt_length_m
        if self._passes is None:
            length_mm = None if length_m is None else 1000 * length_m
            self._passes = BeltPasses(self._rows.side_mm, length_mm, 1000 * self.limits.empty_m)
        events = self._passes.add(self._rows, position_mm, direction, find_splice(self._rows))
        return (
            *self._find_carry_back(self._rows, self._passes),
            *make_event_findings(events, self._rows.side_mm),
        )

    def _find_carry_back(self, rows: CellRows, passes: BeltPasses) -> tuple[Finding, ...]:
        """Return the finding of an empty stretch and the totals; keep that of a load's strips."""
        width_mm = rows.over_mm.shape[1] * rows.side_mm
        beside = make_beside_finding(passes.beside_load, self._zero_sigma_mm, width_mm, self.limits)
        self._beside = () if beside is None or passes.is_empty else (beside,)
        if self._beside:
            passes.count_strips()
        residue = self._residue if passes.is_empty else (_NAN, _NAN)
        findings = make_carry_back_findings(residue, passes, self.limits)
        return findings[1:] if self._beside else findings
