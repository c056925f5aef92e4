"""The shift of the zero averaged over frames: slow drifts become significant below the noise of one frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltscape.health.belt.zero_shift import ZeroShift

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
