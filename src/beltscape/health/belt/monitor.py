"""The checks of heights over a sequence of frames."""

from __future__ import annotations

from beltscape.core.depth import DepthMap
from beltscape.core.findings import Finding
from beltscape.health.belt.cells import compute_belt_cells
from beltscape.health.belt.settings import BeltLimits
from beltscape.health.belt.zero_finding import make_zero_findings
from beltscape.health.belt.zero_history import ZeroHistory, update_zero_history
from beltscape.health.belt.zero_shift import estimate_zero_shift, make_unmeasured_shift
from beltscape.measure.flow.fusion.empty_belt_reference import EmptyBeltReference


class BeltMonitor:
    """Compares the bare belt of each frame with the learned one."""

    def __init__(self, reference: EmptyBeltReference, limits: BeltLimits | None = None) -> None:
        self._reference, self._limits = reference, limits or BeltLimits()
        self._history = ZeroHistory()

    def check(self, depth: DepthMap | None) -> tuple[Finding, ...]:
        """Return the findings of the next frame, before it is measured; None for a frame without a depth map."""
        if not self._limits.enabled:
            return ()
        shift, before = make_unmeasured_shift(0), self._history
        if depth is not None:
            cells = compute_belt_cells(depth, self._reference)
            shift = estimate_zero_shift(
                cells, self._reference.belt, self._reference.cell_mm, self._limits.search_mm
            )
        self._history = update_zero_history(before, shift, 0.5 * self._limits.zero_mm)
        return make_zero_findings(shift, self._history, before, self._reference.cell_mm, self._limits)
