"""Attribution of a contradiction to cameras: those that every plausible explanation contains, or none of them yet."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.faults.isolation import (
    FaultIsolation,
    FrameResiduals,
    compute_frame_residuals,
    exceeds_tolerance,
)
from beltscape.stereo.consistency.faults.moved_cameras import (
    Hypothesis,
    MovementFit,
    find_common,
    list_hypotheses,
)
from beltscape.stereo.consistency.faults.pose_change import PoseChange, fit_pose_change
from beltscape.stereo.consistency.residual_reference import ResidualReference
from beltscape.stereo.consistency.tie_points.tie_points import TiePoints
from beltscape.stereo.consistency.tolerance import Tolerance

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
