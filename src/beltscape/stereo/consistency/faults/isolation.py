"""Fault isolation: the cameras of a frame that contradict the rig, outside the largest set that is consistent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.residual_reference import ResidualReference
from beltscape.stereo.consistency.residuals import compute_disparity_residuals, compute_pair_residuals
from beltscape.stereo.consistency.systematic_residual import (
    LEAST_POINTS,
    SCATTER_SHARE,
    SIGNIFICANT_SIGMAS,
    SystematicResidual,
    estimate_systematic_residual,
)
from beltscape.stereo.consistency.tie_points.tie_points import TiePoints
from beltscape.stereo.consistency.tolerance import Tolerance

_LEAST_INLIERS = 0.5
"""Correct matches have at least this share of inliers."""
_LEAST_SEARCHED = 40
"""With fewer searched points, a lack of matches is no evidence that the image shows something else."""
_LEAST_FOUND = 0.12
"""Share of the searched points that chance does not find."""
_WELL_FOUND = 0.3
"""Share of the searched points that another auxiliary must find before one counts as unmatched."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameResiduals:
    """Systematic residuals of a frame under a rig."""

    epipolar: Mapping[str, SystematicResidual]
    """By auxiliary."""
    disparity: Mapping[tuple[str, str], SystematicResidual]
    """By two auxiliaries."""


@dataclass(frozen=True, slots=True)
class FaultIsolation:
    """Auxiliaries of a frame by their consistency."""

    sound: tuple[str, ...]
    """They agree with the core and with each other; also those that were not measured."""
    contradicting: tuple[str, ...]
    """Their residuals exceed the tolerance."""
    unmatched: tuple[str, ...]
    """Their images show hardly any of the core's points that another auxiliary's image shows."""
    ambiguous: bool
    """Whether more than one set of auxiliaries may be the sound one; then ``sound`` is empty."""

    def find_confirmed(self, epipolar: Mapping[str, SystematicResidual]) -> tuple[str, ...]:
        """Return the sound auxiliaries that were measured: they show how well the rig is known."""
        return tuple(name for name in self.sound if np.isfinite(epipolar[name].rms_px))


def compute_frame_residuals(
    tie_points: TiePoints, rig: Rig, names: tuple[str, ...], reference: ResidualReference | None = None
) -> FrameResiduals:
    """Return the systematic residuals of the tie points in these auxiliaries' images, less those of the reference."""
    pair_residuals = {name: compute_pair_residuals(tie_points, rig, name) for name in names}
    core_px, size_px, scale = tie_points.core_px, rig.core_camera.size_px, tie_points.pixel_scale
    epipolar = {name: pair_residuals[name].epipolar_px for name in names}
    disparity = {
        (one, other): compute_disparity_residuals(pair_residuals[one], pair_residuals[other])
        for one, other in combinations(names, 2)
    }
    if reference is not None:
        epipolar = {n: reference.subtract_epipolar(px, core_px, n) for n, px in epipolar.items()}
        disparity = {pair: reference.subtract_disparity(px, core_px, pair) for pair, px in disparity.items()}
    return FrameResiduals(
        {n: estimate_systematic_residual(px, core_px, size_px, scale) for n, px in epipolar.items()},
        {pair: estimate_systematic_residual(px, core_px, size_px, scale) for pair, px in disparity.items()},
    )


def isolate_faults(tie_points: TiePoints, residuals: FrameResiduals, tolerance: Tolerance) -> FaultIsolation:
    """Find the largest set of auxiliaries that agree with the core and each other; the others are at fault."""
    epipolar = residuals.epipolar
    names = tuple(epipolar)
    measured = tuple(name for name in names if np.isfinite(epipolar[name].rms_px))
    without_match = [name for name in names if _is_unmatched(tie_points, name, epipolar[name])]
    has_real_points = any(
        name not in without_match
        and epipolar[name].points >= _WELL_FOUND * max(tie_points.searched[name].sum(), _LEAST_SEARCHED)
        for name in names
    )
    unmatched = tuple(without_match) if has_real_points else ()
    off = {
        name
        for name in names
        if name not in unmatched and exceeds_tolerance(epipolar[name], tolerance.epipolar_px[name])
    }
    candidates = [name for name in names if name not in off and name not in unmatched]
    conflicts = {
        pair
        for pair, residual in residuals.disparity.items()
        if exceeds_tolerance(residual, tolerance.disparity_px[pair])
    }
    sets = _find_largest_sets(candidates, conflicts)
    agreeing = tuple(name for name in sets[0] if name in measured)
    others = tuple(name for name in names if name not in sets[0] and name not in unmatched)
    ambiguous = len(sets) > 1 or not _is_confirmed(agreeing, others, conflicts)
    sound = () if ambiguous else sets[0]
    contradicting = tuple(name for name in measured if name not in sound and name not in unmatched)
    return FaultIsolation(sound, contradicting, unmatched, ambiguous)


def _is_confirmed(
    sound: tuple[str, ...], contradicting: tuple[str, ...], conflicts: set[tuple[str, str]]
) -> bool:
    """Return whether the sound set has more than one auxiliary: a single one also agrees with a core that moved.

    A single auxiliary is confirmed by another one off its epipolar lines if their depths agree.
    """
    if len(sound) != 1 or not contradicting:
        return True
    return len(contradicting) == 1 and not any(set(pair) == {*sound, *contradicting} for pair in conflicts)


def exceeds_tolerance(residual: SystematicResidual, tolerance_px: float) -> bool:
    """Return whether a systematic residual significantly exceeds its tolerance; False where it was not measured."""
    return bool(
        np.isfinite(residual.rms_px)
        and residual.inlier_share >= _LEAST_INLIERS
        and residual.rms_px - SIGNIFICANT_SIGMAS * residual.sigma_px
        > np.hypot(tolerance_px, SCATTER_SHARE * residual.scatter_px)
    )


def _is_unmatched(tie_points: TiePoints, name: str, residual: SystematicResidual) -> bool:
    searched = int(tie_points.searched[name].sum())
    if searched < _LEAST_SEARCHED:
        return False
    scattered = residual.points >= LEAST_POINTS and not residual.inlier_share >= _LEAST_INLIERS
    return scattered or residual.points < max(_LEAST_FOUND * searched, LEAST_POINTS)


def _find_largest_sets(names: list[str], conflicts: set[tuple[str, str]]) -> list[tuple[str, ...]]:
    """Return every largest subset of the names without a conflicting pair, in order."""
    if not any(one in names and other in names for one, other in conflicts):
        return [tuple(names)]
    for size in range(len(names) - 1, 0, -1):
        subsets = [
            subset
            for subset in combinations(names, size)
            if not any(one in subset and other in subset for one, other in conflicts)
        ]
        if subsets:
            return subsets
    return [()]
