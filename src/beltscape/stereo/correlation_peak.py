"""The position of a correlation's peak, to a fraction of a pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_RIVAL_PX = 3
"""A second peak farther off than this is another place."""
_RIVAL = 0.08
"""By so much the best correlation must exceed that of any other place."""


def refined_peak(match: NDArray[np.float32], least: float) -> tuple[float, float] | None:
    """Return (column, row) of the greatest correlation; None where it is weak, at the border, or has a rival."""
    row, column = divmod(int(np.argmax(match)), match.shape[1])
    best = float(match[row, column])
    if not best >= least or not (0 < row < match.shape[0] - 1 and 0 < column < match.shape[1] - 1):
        return None
    if match.size > (2 * _RIVAL_PX + 1) ** 2:
        others = match.copy()
        top, left = max(0, row - _RIVAL_PX), max(0, column - _RIVAL_PX)
        others[top : row + _RIVAL_PX + 1, left : column + _RIVAL_PX + 1] = -1
        if float(others.max()) > best - _RIVAL:
            return None
    along_u = _vertex(match[row, column - 1], match[row, column], match[row, column + 1])
    along_v = _vertex(match[row - 1, column], match[row, column], match[row + 1, column])
    return column + along_u, row + along_v


def _vertex(before: np.float32, at: np.float32, after: np.float32) -> float:
    """Offset of the vertex of the parabola through three neighbours, within ±0.5."""
    bend = float(before) - 2 * float(at) + float(after)
    return float(np.clip(0.5 * (float(before) - float(after)) / bend, -0.5, 0.5)) if bend < 0 else 0.0
