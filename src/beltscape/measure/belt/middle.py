"""The middle of a belt's cross-section: its flat part, or its line of symmetry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

_MIN_SHARE = 0.12
"""A straight piece shorter than this share of the belt is no flat centre."""
_MAX_TILT = np.deg2rad(12.0)
"""A straight piece inclined more than this to the camera's image plane is a wing, unless it lies between two."""
_MAX_TILT_BETWEEN_WINGS = np.deg2rad(40.0)
"""Limit of the inclination of a piece from which the belt climbs on both sides: then the camera is inclined."""
_WING_SHARE, _WING_CLIMB = 0.05, 0.03
"""A side climbs when more than this share of the belt lies higher than this share of its width above the piece."""
_MAX_SLOPE = 2.0
"""Largest slope of a belt's surface; a steeper one is a step to the floor or a frame."""
_LOWEST_SHARE = 0.002
"""Nodes within this share of the belt's width above the lowest one are its bottom: 60 mm of a round belt 500 mm wide,
5 mm of two rolls at 20°."""


@dataclass(frozen=True, slots=True)
class Middle:
    """The direction of the vertical relative to the cross-section, and the flat part."""

    slope_rad: float
    """Angle of the flat against the section's x; where there is no flat, of the line of symmetry's normal."""
    flat_mm: tuple[float, float] | None
    """The flat's ends in x, or None."""


def find_continuous_nodes(
    x_mm: NDArray[np.float64], z_mm: NDArray[np.float64], noise_mm: float, at_mm: float
) -> slice | None:
    """Return the nodes of the continuous surface through ``at_mm``; None where nothing was measured there."""
    measured = np.flatnonzero(np.isfinite(z_mm))
    if len(measured) < 3:
        return None
    climb = np.abs(np.diff(z_mm[measured])) > _MAX_SLOPE * np.diff(x_mm[measured]) + 6 * noise_mm
    piece = np.r_[0, np.cumsum(climb)]
    nearest = int(np.argmin(np.abs(x_mm[measured] - at_mm)))
    own = measured[piece == piece[nearest]]
    if len(own) < 3 or abs(x_mm[measured[nearest]] - at_mm) > 0.1 * (x_mm[-1] - x_mm[0]):
        return None
    return slice(int(own[0]), int(own[-1]) + 1)


def find_middle(x_mm: NDArray[np.float64], z_mm: NDArray[np.float64], tolerance_mm: float) -> Middle:
    """Find the flat centre of a belt's cross-section (K,), or its symmetry where it has no flat.

    Candidates are the lines through two nodes that are little inclined, or from which the belt climbs on both
    sides. The flat is the candidate with most nodes on it; wings are steeper and end freely on one side.
    """
    measured = np.isfinite(z_mm)
    x, z = x_mm[measured], z_mm[measured]
    first, second = np.triu_indices(len(x), k=max(3, len(x) // 40))
    angle = np.arctan2(z[second] - z[first], x[second] - x[first])
    keep = np.abs(angle) < _MAX_TILT_BETWEEN_WINGS
    first, second, angle = first[keep], second[keep], angle[keep]
    if len(first):
        off = z[None] - z[first, None] - np.tan(angle)[:, None] * (x[None] - x[first, None])
        score = np.clip(1 - (off / tolerance_mm) ** 2, 0, None).sum(axis=1)
        is_between = _is_between_wings(off > _WING_CLIMB * np.ptp(x), first, second)
        limit = cast("NDArray[np.float64]", np.where(is_between, _MAX_TILT_BETWEEN_WINGS, _MAX_TILT))
        # a shallow wing may be longer than the flat, but it is steeper
        best = int(
            np.argmax(score * np.clip(1 - 0.75 * (angle / limit) ** 2, 0.25, None) * (np.abs(angle) < limit))
        )
        on = _find_longest_run(np.abs(off[best]) < tolerance_mm)
        if on is not None and on.stop - on.start >= _MIN_SHARE * len(x) and abs(angle[best]) < limit[best]:
            slope = np.polyfit(x[on], z[on], 1)[0]
            return Middle(float(np.arctan(slope)), (float(x[on][0]), float(x[on][-1])))
    return Middle(_find_symmetry(x, z), None)


def _is_between_wings(
    above: NDArray[np.bool_], first: NDArray[np.intp], second: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Return (M,) whether the belt is ``above`` (M, K) each line left of its first and right of its second node."""
    node = np.arange(int(above.shape[1]))
    left = (above & (node < first[:, None])).mean(axis=1)
    right = (above & (node > second[:, None])).mean(axis=1)
    return np.minimum(left, right) > _WING_SHARE


def _find_longest_run(flags: NDArray[np.bool_]) -> slice | None:
    """Return the longest run of True, in which gaps of two are bridged."""
    on = np.flatnonzero(flags)
    if not len(on):
        return None
    breaks = np.flatnonzero(np.diff(on) > 3)
    starts, stops = np.r_[0, breaks + 1], np.r_[breaks, len(on) - 1]
    longest = int(np.argmax(on[stops] - on[starts]))
    return slice(int(on[starts[longest]]), int(on[stops[longest]]) + 1)


def _find_symmetry(x: NDArray[np.float64], z: NDArray[np.float64]) -> float:
    """Return the rotation (rad) after which both sides of the lowest point climb equally."""
    turn = 0.0
    for _ in range(20):
        height = np.cos(turn) * z - np.sin(turn) * x
        # the middle of the lowest nodes: a single one is moved by noise on a round bottom
        lowest = np.flatnonzero(height <= height.min() + _LOWEST_SHARE * np.ptp(x))
        low = min(max(round(float(lowest.mean())), 3), len(x) - 3)
        left, right = np.polyfit(x[:low], z[:low], 1)[0], np.polyfit(x[low:], z[low:], 1)[0]
        half = 0.5 * float(np.arctan(left) + np.arctan(right))
        if abs(half - turn) < 1e-9:
            break
        turn = half
    return turn
