"""The checks of heights over a sequence of frames."""

from __future__ import annotations

from beltscape.core.depth import DepthMap
from beltscape.core.live.findings import Finding
from beltscape.health.belt.belt_findings import (
    make_beside_finding,
    make_carry_back_findings,
    make_event_findings,
)
from beltscape.health.belt.cells import compute_belt_cells
from beltscape.health.belt.passes import BeltPasses
from beltscape.health.belt.residue import BeltRows, arrange_rows, measure_residue
from beltscape.health.belt.settings import BeltLimits
from beltscape.health.belt.splices import find_splice
from beltscape.health.belt.zero_finding import make_zero_findings
from beltscape.health.belt.zero_history import ZeroHistory, update_zero_history
from beltscape.health.belt.zero_shift import estimate_zero_shift, make_unmeasured_shift
from beltscape.measure.flow.fusion.empty_belt_reference import EmptyBeltReference

_NAN = float("nan")


class BeltMonitor:
    """Compares the bare belt of each frame with the learned one, and follows what is stuck to it."""

    def __init__(self, reference: EmptyBeltReference, limits: BeltLimits | None = None) -> None:
        self._reference, self._limits = reference, limits or BeltLimits()
        self._history = ZeroHistory()
        self._rows: BeltRows | None = None
        self._residue = (_NAN, _NAN)
        self._zero_sigma_mm = _NAN
        self._beside: tuple[Finding, ...] = ()
        """What lay beside the load by the last `follow`, for the records of the next frame."""
        self._passes: BeltPasses | None = None

    @property
    def history(self) -> ZeroHistory:
        """Return the average shift of the zero, the correction that setting it would make."""
        return self._history

    def check(self, depth: DepthMap | None) -> tuple[Finding, ...]:
        """Return the findings of the next frame, before it is measured; None for a frame without a depth map."""
        if not self._limits.enabled:
            return ()
        shift, before = make_unmeasured_shift(0), self._history
        self._rows, self._residue = None, (_NAN, _NAN)
        if depth is not None:
            cells = compute_belt_cells(depth, self._reference)
            shift = estimate_zero_shift(
                cells, self._reference.belt, self._reference.cell_mm, self._limits.search_mm
            )
            if shift.is_measured:
                self._rows = arrange_rows(cells, shift)
                self._residue = measure_residue(self._rows, shift)
                self._zero_sigma_mm = shift.sigma_mm
        self._history = update_zero_history(before, shift, 0.5 * self._limits.zero_mm)
        zero = make_zero_findings(shift, self._history, before, self._reference.cell_mm, self._limits)
        return (*zero, *self._beside)

    def follow(self, position_mm: float | None, direction: int) -> tuple[Finding, ...]:
        """Return the findings about carry-back, splices and edges in the frame of the last `check`.

        ``position_mm`` is the belt's position at it; None: not known, then nothing is followed.
        """
        if self._rows is None or position_mm is None:
            return ()
        length_m = self._limits.belt_length_m
        if self._passes is None:
            length_mm = None if length_m is None else 1000 * length_m
            self._passes = BeltPasses(self._rows.side_mm, length_mm, 1000 * self._limits.empty_m)
        events = self._passes.add(self._rows, position_mm, direction, find_splice(self._rows))
        return (
            *self._find_carry_back(self._rows, self._passes),
            *make_event_findings(events, self._rows.side_mm),
        )

    def _find_carry_back(self, rows: BeltRows, passes: BeltPasses) -> tuple[Finding, ...]:
        """Return the finding of an empty stretch and the totals; keep that of a load's strips."""
        width_mm = rows.over_mm.shape[1] * rows.side_mm
        beside = make_beside_finding(passes.beside_load, self._zero_sigma_mm, width_mm, self._limits)
        self._beside = () if beside is None or passes.is_empty else (beside,)
        if self._beside:
            passes.count_strips()
        residue = self._residue if passes.is_empty else (_NAN, _NAN)
        findings = make_carry_back_findings(residue, passes, self._limits)
        return findings[1:] if self._beside else findings
