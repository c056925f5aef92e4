"""Fault isolation: the cameras of a frame that contradict the rig, outside the largest set that is consistent.

A contradiction is attributed to the cameras that every plausible explanation contains, or to none of them yet.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.pose_change import (
    Hypothesis,
    MovementFit,
    PoseChange,
    find_common,
    fit_pose_change,
    list_hypotheses,
)
from beltscape.stereo.consistency.residuals import (
    LEAST_POINTS,
    SCATTER_SHARE,
    SIGNIFICANT_SIGMAS,
    PairResiduals,
    ResidualReference,
    SystematicResidual,
    compute_disparity_residuals,
    compute_pair_residuals,
    estimate_systematic_residual,
)
from beltscape.stereo.consistency.tie_points import TiePoints
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
    points: Mapping[str, PairResiduals]
    """By auxiliary: the residuals of the single points, of which no reference is subtracted."""


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
        pair_residuals,
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


_EXPLAINED = 2.0
"""A movement explains residuals that it brings within this multiple of their tolerances."""
_MOST_MOVED = 2
"""Sets of at most this number of cameras are compared; a knock seldom moves more, and the number of sets grows."""
_CONFIRMING = 2
"""Number of sound auxiliaries that show the core to be where the rig says; one also agrees with a core that moved."""


@dataclass(frozen=True, slots=True, eq=False)
class Attribution:
    """Cameras to which the contradictions of a frame are attributed."""

    isolation: FaultIsolation
    """The auxiliaries by their consistency, according to the cameras that moved if these are known."""
    core_moved: bool = False
    """Whether every plausible explanation is a movement of the core, alone or with others."""
    suspects: tuple[str, ...] = ()
    """Cameras of which some moved, while the frame does not show which; empty: it does, or nothing is compared."""
    pose_change: PoseChange | None = None
    """The pose change that explains the frame, of the only camera that moved."""
    has_result: bool = False
    """Whether cameras are accused, or suspected, because their movement explains the frame."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameData:
    """Inputs of an attribution."""

    tie_points: TiePoints
    rig: Rig
    residuals: FrameResiduals
    tolerance: Tolerance
    reference: ResidualReference | None


def attribute_faults(data: FrameData, isolation: FaultIsolation) -> Attribution:
    """Return the cameras that moved, by comparing all explanations; the isolation's where none can be compared."""
    epipolar = data.residuals.epipolar
    names = tuple(n for n in epipolar if np.isfinite(epipolar[n].rms_px) and n not in isolation.unmatched)
    fit = MovementFit(data.tie_points, data.rig, names, data.reference)
    cameras = (data.rig.core, *names)
    sizes = [size for size in range(1, _MOST_MOVED + 1) if list_hypotheses(cameras, size)]
    if not sizes:
        return Attribution(isolation)
    suspects, is_explained = cameras, False
    sizes = [size for size in sizes if fit.has_enough(size)]
    for compare, size in product((fit.compare_movements, fit.compare_displacements), sizes):
        hypotheses = compare(size)
        common, possible = find_common(hypotheses)
        if not _explains(data, hypotheses[0], names):
            continue
        if common and (data.rig.core in common or not _is_inconsistent(data, names, without=common)):
            return _accuse(data, isolation, names, common)
        if not is_explained:
            suspects, is_explained = possible, True
    if sizes and not is_explained and not isolation.ambiguous and _is_isolated(isolation, data.residuals):
        return Attribution(isolation)
    return Attribution(isolation, suspects=suspects, has_result=is_explained)


def _accuse(
    data: FrameData, isolation: FaultIsolation, names: tuple[str, ...], cameras: tuple[str, ...]
) -> Attribution:
    """Return the attribution to these cameras, with the pose change if a single one explains the frame."""
    change = None
    if len(cameras) == 1:
        change = fit_pose_change(data.tie_points, data.rig, cameras[0], names, data.reference)
        change = change if _explains_all(data, change.rig, names) else None
    core_moved = data.rig.core in cameras
    moved = names if core_moved else cameras
    sound = tuple(n for n in data.residuals.epipolar if n not in moved and n not in isolation.unmatched)
    return Attribution(
        FaultIsolation(sound, moved, isolation.unmatched, ambiguous=False),
        core_moved=core_moved,
        pose_change=change,
        has_result=True,
    )


def _is_isolated(isolation: FaultIsolation, residuals: FrameResiduals) -> bool:
    """Return whether more auxiliaries contradict the rig than sets are compared of, or others confirm it.

    What no movement explains, while two others agree with the core and each other, is an image of another instant.
    """
    confirmed = isolation.find_confirmed(residuals.epipolar)
    return len(isolation.contradicting) > _MOST_MOVED or len(confirmed) >= _CONFIRMING


def _is_inconsistent(data: FrameData, names: tuple[str, ...], without: tuple[str, ...]) -> bool:
    """Return whether auxiliaries contradict the core or each other, without some of them."""
    return _exceeds(data, data.residuals, tuple(n for n in names if n not in without), 1.0)


def _explains(data: FrameData, hypothesis: Hypothesis, names: tuple[str, ...]) -> bool:
    """Return whether what a hypothesis leaves is within `_EXPLAINED` times the tolerances."""
    if hypothesis.rig is not data.rig:
        return _explains_all(data, hypothesis.rig, names)
    limits = [data.tolerance.epipolar_px[name] for name in names]
    limits += [data.tolerance.disparity_px[pair] for pair in combinations(names, 2)]
    return bool((np.nan_to_num(hypothesis.left_px) <= _EXPLAINED * np.array(limits)).all())


def _explains_all(data: FrameData, rig: Rig, names: tuple[str, ...]) -> bool:
    """Return whether the residuals under a rig after a movement are within `_EXPLAINED` times their tolerances."""
    after = compute_frame_residuals(data.tie_points, rig, names, data.reference)
    return not _exceeds(data, after, names, _EXPLAINED)


def _exceeds(data: FrameData, residuals: FrameResiduals, names: tuple[str, ...], factor: float) -> bool:
    """Return whether a residual of these auxiliaries exceeds its tolerance times a factor."""
    tolerance = data.tolerance
    return any(
        exceeds_tolerance(residuals.epipolar[name], factor * tolerance.epipolar_px[name]) for name in names
    ) or any(
        exceeds_tolerance(residual, factor * tolerance.disparity_px[pair])
        for pair, residual in residuals.disparity.items()
        if set(pair) <= set(names)
    )
