"""Subpixel position of the peak of a correlation map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_PEAK_PX = 3
"""A correlation farther from the peak than this belongs to another position."""
_LEAST_LEAD = 0.08
"""Least difference of the peak's correlation from that of any other position."""


def refine_peak(match: NDArray[np.float32], least: float) -> tuple[float, float] | None:
    """Return (column, row) of the greatest correlation; None where it is weak, ambiguous or at the border."""
    row, column = divmod(int(np.argmax(match)), match.shape[1])
    best = float(match[row, column])
    if not best >= least or not (0 < row < match.shape[0] - 1 and 0 < column < match.shape[1] - 1):
        return None
    if match.size > (2 * _PEAK_PX + 1) ** 2:
        others = match.copy()
        top, left = max(0, row - _PEAK_PX), max(0, column - _PEAK_PX)
        others[top : row + _PEAK_PX + 1, left : column + _PEAK_PX + 1] = -1
        if float(others.max()) > best - _LEAST_LEAD:
            return None
    along_u = _find_vertex(match[row, column - 1], match[row, column], match[row, column + 1])
    along_v = _find_vertex(match[row - 1, column], match[row, column], match[row + 1, column])
    return column + along_u, row + along_v


def _find_vertex(before: np.float32, at: np.float32, after: np.float32) -> float:
    """Return the offset of the vertex of the parabola through three neighbours, within ±0.5."""
    bend = float(before) - 2 * float(at) + float(after)
    return float(np.clip(0.5 * (float(before) - float(after)) / bend, -0.5, 0.5)) if bend < 0 else 0.0
