"""Semi-global selection among the candidates that the pixels keep."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.selection.propagation import Propagated

Array = NDArray[np.float64]

NO_CANDIDATE = 1e6
"""The inverse depth of an empty place: far from all others, and exact in single precision."""

STEEPEST_STEP = 1.0
"""Largest step of s between neighbours that their slopes may explain; half and double change the share within 0.25 mm
of a quarter-size heap by 0.04 %."""
DIRECTIONS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1))
"""Steps (dx, dy) along the eight paths."""


class Kept(NamedTuple):
    """Candidates, (H, W, K) each."""

    s: Array
    slope_u: Array
    slope_v: Array
    cost: Array

    def rows(self, first: int, end: int) -> Kept:
        """Return the candidates of rows first … end - 1."""
        return Kept(*(field[first:end] for field in self))

    def at(self, y: int, x: slice) -> Kept:
        """Return the candidates of a row's pixels, (n, K) each."""
        return Kept(*(field[y, x] for field in self))


APART = 1.5
"""Candidates farther apart in s are different surfaces. The network of confidence was fitted with this value; half
and double change the measured share of a quarter-size heap by 0.1 %."""


def choose(kept: Kept, small_jump: float, large_jump: float) -> Propagated:
    """Return the candidates with the least sum of cost and mean cost of the eight paths."""
    paths = [_path(kept, dx, dy, small_jump, large_jump) for dx, dy in DIRECTIONS]
    totals = kept.cost + np.mean(paths, axis=0)
    best = totals.argmin(axis=2)[..., None]
    s, slope_u, slope_v, cost = (np.take_along_axis(field, best, axis=2)[..., 0] for field in kept)
    apart = np.abs(kept.s - s[..., None]) > APART
    margin = np.minimum(np.where(apart, totals, np.inf).min(axis=2) - totals.min(axis=2), 1)
    none = s == NO_CANDIDATE
    s, cost, margin = (np.where(none, np.nan, field) for field in (s, cost, margin))
    return Propagated(s, slope_u, slope_v, cost, margin)


def _path(kept: Kept, dx: int, dy: int, small_jump: float, large_jump: float) -> Array:
    """Return (H, W, K) the cost of each candidate on the paths of one direction."""
    if dy == 0:  # the same along columns
        turned = Kept(*(field.swapaxes(0, 1) for field in (kept.s, kept.slope_v, kept.slope_u, kept.cost)))
        return _path(turned, 0, dx, small_jump, large_jump).swapaxes(0, 1)
    height, width, _ = kept.s.shape
    brought = np.zeros(kept.s.shape)
    to, from_ = slice(max(dx, 0), width + min(dx, 0)), slice(max(-dx, 0), width - max(dx, 0))
    rows = range(height) if dy > 0 else range(height - 1, -1, -1)
    for y in rows[1:]:
        before, here = kept.at(y - dy, from_), kept.at(y, to)
        toll = before.cost + brought[y - dy, from_]
        toll -= toll.min(axis=1, keepdims=True)
        least = (toll[:, None] + _jump(before, here, dx, dy, small_jump)).min(axis=2)
        brought[y, to] = np.minimum(least, large_jump)
    return brought


def _jump(before: Kept, here: Kept, dx: int, dy: int, small_jump: float) -> Array:
    """Return (n, K, K) costs of the step from each candidate of the pixels before (last axis) to each one here."""
    slope_u = (here.slope_u[:, :, None] + before.slope_u[:, None]) / 2
    slope_v = (here.slope_v[:, :, None] + before.slope_v[:, None]) / 2
    expected = np.clip(slope_u * dx + slope_v * dy, -STEEPEST_STEP, STEEPEST_STEP)
    return small_jump * np.abs(here.s[:, :, None] - before.s[:, None] - expected)
