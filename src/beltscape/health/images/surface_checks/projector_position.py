"""Position of the projector: the pattern on the bare belt, at its known height, against the learned pattern."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.live.findings import Finding
from beltscape.core.live.translatable_message import Message
from beltscape.health.images.surface_checks.motion_correlation import correlate_at_rest, find_peak
from beltscape.health.images.surface_checks.surface_samples import Texture
from beltscape.health.settings import HealthSettings

MOVED = "projector_moved"
SEARCH_CELLS = 24
"""Farthest displacement that is searched, cells; a pattern that moved farther counts as not found."""
_SIGMA_CELLS = 0.03
"""σ of the pattern's displacement, cells; sound captures scatter by 0.01."""
_PER_HEIGHT = 1.0
"""Displacement of the pattern per change of the belt's height: cameras and projector are within 45° of each other."""
_FOUND = 0.3
"""Correlation with the learned pattern from which its displacement is measured; sound captures: 0.7 to 0.95."""
_SAME_PATTERN = 0.45
"""Correlation between two cameras that both see the projected pattern, wherever it is; without projector: 0.1."""
_AGREEING = 2 / 3
"""Share of the cameras that must show the same displacement: a camera that moved shows it alone."""
_LEAST_SHARE = 0.01
"""Least share of the grid that is bare."""


@dataclass(frozen=True, slots=True, eq=False)
class LearnedPattern:
    """The mean texture of the bare belt while the projector was sound, on the grid of the core's view."""

    textures: Mapping[str, Texture]
    """Camera → texture (H, W) at the points of the learned empty belt; NaN: never seen bare."""
    height_mm: float
    """Mean height of the bare belt over the learned one."""


@dataclass(frozen=True, slots=True)
class PatternShift:
    """Displacement of the pattern on the bare belt."""

    shift_mm: float
    """Length of the displacement; infinite: the pattern is not found within the search; NaN: not measured."""
    sigma_mm: float
    allowance_mm: float
    """Displacement that a change of the belt's height may explain."""


UNMEASURED = PatternShift(float("nan"), float("nan"), float("nan"))


def measure_pattern_shift(
    learned: LearnedPattern,
    now: Mapping[str, Texture],
    is_bare: NDArray[np.bool_],
    height_mm: float,
    cell_mm: float,
    core: str,
) -> PatternShift:
    """Return the displacement of the pattern that most cameras show, on the half of the bare belt where it is larger.

    A projector that turned about its axis moves the pattern to opposite sides on the two halves.

    Parameters
    ----------
    learned
        The learned pattern.
    now
        The cameras' textures (H, W) at the points of the learned empty belt.
    is_bare
        (H, W) where the belt is bare at its learned height.
    height_mm
        Mean height there over the learned belt.
    cell_mm
        Width of a cell on the belt.
    core
        Name of the core camera.
    """
    if core not in now:
        return UNMEASURED
    allowance = _PER_HEIGHT * abs(height_mm - learned.height_mm)
    lengths = [_measure_length(learned, now, half, core) for half in _split(is_bare)]
    finite = [length for length in lengths if np.isfinite(length)]
    if finite:
        return PatternShift(cell_mm * max(finite), cell_mm * _SIGMA_CELLS, allowance)
    if lengths and all(np.isinf(length) for length in lengths):
        return PatternShift(float("inf"), SEARCH_CELLS * cell_mm, allowance)
    return UNMEASURED


def _split(is_bare: NDArray[np.bool_]) -> list[NDArray[np.bool_]]:
    """Return the left and the right half of the bare belt (H, W), those that are large enough."""
    if not is_bare.any():
        return []
    left = is_bare.copy()
    left[:, int(np.median(np.nonzero(is_bare)[1])) :] = False
    halves = left, is_bare & ~left
    return [half for half in halves if half.mean() >= _LEAST_SHARE]


def _measure_length(
    learned: LearnedPattern, now: Mapping[str, Texture], is_bare: NDArray[np.bool_], core: str
) -> float:
    """Return the displacement in cells; infinite: the pattern is projected elsewhere; NaN: not measured."""
    shifts: list[NDArray[np.float64]] = []
    lost = 0
    names = [name for name in now if name in learned.textures]
    for name in names:
        shift, correlation = find_peak(now[name], learned.textures[name], is_bare, SEARCH_CELLS, _LEAST_SHARE)
        if correlation >= _FOUND:
            shifts.append(-shift)
        elif name != core:
            rest = correlate_at_rest(now[core], now[name], is_bare, _LEAST_SHARE)
            lost += rest > _SAME_PATTERN
    if len(shifts) < 2:
        is_lost = len(names) > 2 and lost >= _AGREEING * (len(names) - 1)
        return float("inf") if is_lost else float("nan")
    middle = np.median(shifts, axis=0)
    length = float(np.linalg.norm(middle))
    agree = [float(np.linalg.norm(shift - middle)) < max(1.0, 0.3 * length) for shift in shifts]
    return length if np.mean(agree) >= _AGREEING else float("nan")


def check_projector_position(shift: PatternShift, is_confirmed: bool, settings: HealthSettings) -> Finding:
    """Return the finding "projector_moved": the displacement of the pattern on the bare belt, mm.

    Depth is measured with the pattern wherever it is, so that the finding has no effect on records.
    """
    limit = settings.projector_mm + (0.0 if np.isnan(shift.allowance_mm) else shift.allowance_mm)
    is_far = np.isinf(shift.shift_mm)
    value = shift.sigma_mm if is_far else shift.shift_mm
    finding = Finding(MOVED, value, shift.sigma_mm, limit, "mm")
    if not exceeds(shift, settings):
        return finding
    if not is_confirmed:
        return Finding(MOVED, float("nan"), shift.sigma_mm, limit, "mm")
    size = f"by more than {value:.0f} mm" if is_far else f"by {value:.1f} mm"
    text = Message(
        f"the projected pattern has moved {size} on the belt: the projector has moved or turned; depth stays right, "
        "but check that the pattern covers the belt, fasten the projector and restart the measurement",
        "projector_far" if is_far else "projector_moved",
        shift=round(value, 1),
    )
    return Finding(MOVED, value, shift.sigma_mm, limit, "mm", "", text)


def exceeds(shift: PatternShift, settings: HealthSettings) -> bool:
    """Return whether the displacement is beyond the limit, 3 σ and what the belt's height explains."""
    return shift.shift_mm > max(settings.projector_mm, 3 * shift.sigma_mm) + shift.allowance_mm
