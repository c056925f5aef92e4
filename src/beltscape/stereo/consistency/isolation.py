"""Which cameras of a frame contradict the rig: the largest set of auxiliaries that agree is taken for sound."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from beltscape.core.rig import Rig
from beltscape.stereo.consistency.allowance import Allowance
from beltscape.stereo.consistency.residuals import disparity_px, pair_residuals
from beltscape.stereo.consistency.tie_points import TiePoints
from beltscape.stereo.consistency.trend import LEAST_POINTS, OF_SCATTER, Trend, trend_of

_SIGMAS = 4.0
"""A trend counts beyond its allowance by so many of its own standard deviations."""
_CONCENTRATED = 0.5
"""Share of residuals that lie together where the matches are real."""
_LEAST_SEARCHED = 40
"""From so many searched points on, hardly a match means that the image shows something else."""
_LEAST_FOUND = 0.12
"""Share of them that chance does not find."""
_WELL_FOUND = 0.3
"""Share that another auxiliary must find before one is said to show something else: the points are real then."""


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Systematic residuals of a frame under a rig."""

    across: Mapping[str, Trend]
    """By auxiliary."""
    between: Mapping[tuple[str, str], Trend]
    """By two auxiliaries."""


@dataclass(frozen=True, slots=True)
class Isolation:
    """Auxiliaries by what the frame says of them."""

    sound: tuple[str, ...]
    """They agree with the core and with each other; also those of which the frame says nothing."""
    contradicting: tuple[str, ...]
    """Their residuals are beyond what the rig allows."""
    unmatched: tuple[str, ...]
    """Their images show hardly a point of the core's that another auxiliary's image shows."""
    ambiguous: bool
    """Whether another set of auxiliaries could as well be the sound one; then none is taken for sound."""


def residuals_of(tie: TiePoints, rig: Rig, names: tuple[str, ...]) -> Residuals:
    """Return the trends of the tie points of some auxiliaries."""
    each = {name: pair_residuals(tie, rig, name) for name in names}
    size, pixel = rig.core_camera.size_px, tie.pixel
    across = {name: trend_of(each[name].across_px, tie.core_px, size, pixel) for name in names}
    between = {
        (one, other): trend_of(disparity_px(each[one], each[other]), tie.core_px, size, pixel)
        for one, other in combinations(names, 2)
    }
    return Residuals(across, between)


def isolate(tie: TiePoints, residuals: Residuals, allowance: Allowance) -> Isolation:
    """Return the largest set of auxiliaries that agree with the core and each other, and the others."""
    names = tuple(residuals.across)
    measured = tuple(name for name in names if np.isfinite(residuals.across[name].rms_px))
    lost = [name for name in names if _is_unmatched(tie, name, residuals.across[name])]
    real = any(
        name not in lost
        and residuals.across[name].points >= _WELL_FOUND * max(tie.searched[name].sum(), _LEAST_SEARCHED)
        for name in names
    )
    unmatched = tuple(lost) if real else ()
    off = {
        name
        for name in names
        if name not in unmatched and exceeds(residuals.across[name], allowance.across_px[name])
    }
    candidates = [name for name in names if name not in off and name not in unmatched]
    apart = {pair for pair, trend in residuals.between.items() if exceeds(trend, allowance.between_px[pair])}
    sets = _largest_sets(candidates, apart)
    agreeing = tuple(name for name in sets[0] if name in measured)
    others = tuple(name for name in names if name not in sets[0] and name not in unmatched)
    ambiguous = len(sets) > 1 or not _is_confirmed(agreeing, others, apart)
    sound = () if ambiguous else sets[0]
    contradicting = tuple(name for name in measured if name not in sound and name not in unmatched)
    return Isolation(sound, contradicting, unmatched, ambiguous)


def _is_confirmed(
    sound: tuple[str, ...], contradicting: tuple[str, ...], apart: set[tuple[str, str]]
) -> bool:
    """Whether the sound set stands on more than one auxiliary: one alone agrees with a core that moved as well.

    One auxiliary beside one that is off its epipolar lines is believed only where their depths agree.
    """
    if len(sound) != 1 or not contradicting:
        return True
    return len(contradicting) == 1 and not any(set(pair) == {*sound, *contradicting} for pair in apart)


def exceeds(trend: Trend, allowed_px: float) -> bool:
    """Whether a trend is beyond its allowance, significantly; False where it was not measured."""
    return bool(
        np.isfinite(trend.rms_px)
        and trend.concentration >= _CONCENTRATED
        and trend.rms_px - _SIGMAS * trend.sigma_px > np.hypot(allowed_px, OF_SCATTER * trend.scatter_px)
    )


def _is_unmatched(tie: TiePoints, name: str, trend: Trend) -> bool:
    searched = int(tie.searched[name].sum())
    if searched < _LEAST_SEARCHED:
        return False
    scattered = trend.points >= LEAST_POINTS and not trend.concentration >= _CONCENTRATED
    return scattered or trend.points < max(_LEAST_FOUND * searched, LEAST_POINTS)


def _largest_sets(names: list[str], apart: set[tuple[str, str]]) -> list[tuple[str, ...]]:
    """Every largest subset of the names that holds no two that are apart, in order."""
    if not any(one in names and other in names for one, other in apart):
        return [tuple(names)]
    for size in range(len(names) - 1, 0, -1):
        found = [
            some
            for some in combinations(names, size)
            if not any(one in some and other in some for one, other in apart)
        ]
        if found:
            return found
    return [()]
