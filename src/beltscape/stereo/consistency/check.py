"""Consistency check of the cameras of one frame: the images against the rig and, if there is one, the depth map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.faults.attribution import Attribution, FrameData, attribute_faults
from beltscape.stereo.consistency.faults.isolation import (
    FaultIsolation,
    FrameResiduals,
    compute_frame_residuals,
    isolate_faults,
)
from beltscape.stereo.consistency.residual_reference import ResidualReference
from beltscape.stereo.consistency.residuals import PairResiduals, compute_pair_residuals
from beltscape.stereo.consistency.rig_consistency import CameraConsistency, RigConsistency, State
from beltscape.stereo.consistency.tie_points.guided_matching import match_guided
from beltscape.stereo.consistency.tie_points.tie_points import Array, TiePoints, detect_textured_points
from beltscape.stereo.consistency.tie_points.unguided_matching import UnguidedMatcher
from beltscape.stereo.consistency.tolerance import Tolerance, compute_tolerance
from beltscape.stereo.multiview.initialisation.depth_range import compute_search_range

LEAST_COVERAGE = 0.3
"""A depth map with less coverage is not used for guided matching: its few pixels are chance matches."""
LEAST_TIE_POINTS = 30
"""With fewer tie points in the depth map, unguided matching is used."""
_AGREES_PX = 1.0
"""A point agrees with the rig within this distance from its epipolar line."""


def check_consistency(
    frame_set: FrameSet,
    rig: Rig,
    depth: DepthMap | None,
    auxiliaries: tuple[str, ...] | None = None,
    tolerance: Tolerance | None = None,
) -> RigConsistency:
    """Measure how well each auxiliary's image agrees with the rig and with the depth that the others give.

    Parameters
    ----------
    frame_set
        The core's image and at least one auxiliary's.
    rig
        The rig to check.
    depth
        Depth map of the frame under this rig. Without it, or if its coverage is low, the points are matched in
        small rectified images, to about half a pixel of theirs.
    auxiliaries
        Auxiliaries to check; those that have an image by default.
    tolerance
        Result of `compute_tolerance`, computed once for many frames of one rig.
    """
    names = tuple(n for n in auxiliaries or rig.auxiliaries if n in frame_set.images)
    points = detect_textured_points(frame_set.images[rig.core], rig.core_camera)
    tie_points, guided = _match_tie_points(frame_set, rig, names, depth, points)
    if tolerance is None:
        tolerance = compute_tolerance(
            rig,
            float(1 / np.median(tie_points.inverse_depth))
            if len(tie_points.inverse_depth)
            else sum(compute_search_range(rig, names)) / 2,
        )
    if not guided:
        tolerance = tolerance.widen(tie_points.pixel_scale)
    consistency = assess_tie_points(tie_points, rig, names, tolerance)
    return replace(consistency, textured_points=len(points), guided=guided)


def assess_tie_points(
    tie_points: TiePoints,
    rig: Rig,
    names: tuple[str, ...],
    tolerance: Tolerance,
    reference: ResidualReference | None = None,
) -> RigConsistency:
    """Return the consistency of auxiliaries by the tie points of one or more frames.

    With a ``reference`` the residuals are those in excess of it, and the tolerance is that of their change.
    """
    residuals = compute_frame_residuals(tie_points, rig, names, reference)
    isolation = isolate_faults(tie_points, residuals, tolerance)
    attribution = Attribution(isolation)
    if isolation.contradicting:
        data = FrameData(tie_points, rig, residuals, tolerance, reference)
        attribution = attribute_faults(data, isolation)
        isolation = attribution.isolation
    cameras = tuple(_assess_camera(name, tie_points, rig, residuals, isolation, tolerance) for name in names)
    return RigConsistency(
        cameras,
        len(tie_points.core_px),
        True,
        isolation.ambiguous,
        attribution.core_moved,
        attribution.pose_change,
        _find_depth_range(tie_points, rig, residuals),
        _compute_misfit(residuals, () if attribution.suspects else isolation.sound),
        tie_points,
        reference is not None,
        attribution.suspects,
    )


def _match_tie_points(
    frame_set: FrameSet, rig: Rig, names: tuple[str, ...], depth: DepthMap | None, points: Array
) -> tuple[TiePoints, bool]:
    """Return the tie points, and whether the depth map guided their matching."""
    if depth is not None and depth.coverage >= LEAST_COVERAGE:
        tie_points = match_guided(frame_set, rig, names, depth, points)
        if len(tie_points.core_px) >= LEAST_TIE_POINTS:
            return tie_points, True
    return UnguidedMatcher(rig, compute_search_range(rig, names)).match(frame_set, names, points), False


def _assess_camera(
    name: str,
    tie_points: TiePoints,
    rig: Rig,
    residuals: FrameResiduals,
    isolation: FaultIsolation,
    tolerance: Tolerance,
) -> CameraConsistency:
    epipolar = residuals.epipolar[name]
    searched = int(tie_points.searched[name].sum())
    pair_residuals = compute_pair_residuals(tie_points, rig, name)
    agreeing = int((np.abs(pair_residuals.epipolar_px) < _AGREES_PX * tie_points.pixel_scale).sum())
    partners = [n for n in isolation.sound if n != name] or [n for n in residuals.epipolar if n != name]
    disparity = [
        residual.rms_px
        for pair, residual in residuals.disparity.items()
        if name in pair and any(n in pair for n in partners) and np.isfinite(residual.rms_px)
    ]
    state: State = "not measured" if not np.isfinite(epipolar.rms_px) else "sound"
    if name in isolation.unmatched:
        state = "unmatched"
    elif name in isolation.contradicting:
        state = "contradicting"
    return CameraConsistency(
        name,
        state,
        epipolar.rms_px,
        epipolar.sigma_px,
        float(np.median(disparity)) if disparity else float("nan"),
        tolerance.epipolar_px[name],
        epipolar.points,
        searched,
        agreeing / searched if searched else float("nan"),
        _compute_depth_error(tie_points, pair_residuals),
    )


def _compute_depth_error(tie_points: TiePoints, residuals: PairResiduals) -> float:
    """Return the error of the depth per pixel along the epipolar lines of an auxiliary, mm, as a median."""
    if not len(tie_points.core_px):
        return float("nan")
    return float(np.median(1 / (np.square(tie_points.inverse_depth) * residuals.sensitivity_px_mm)))


def _compute_misfit(residuals: FrameResiduals, sound: tuple[str, ...]) -> float:
    """Return the greatest excess of a systematic residual among the sound auxiliaries, or all without any, px."""
    measured = tuple(name for name in sound if np.isfinite(residuals.epipolar[name].rms_px))
    names = measured or tuple(residuals.epipolar)
    own = [residuals.epipolar[name] for name in names]
    own += [residual for pair, residual in residuals.disparity.items() if set(pair) <= set(names)]
    return max((residual.excess_px for residual in own), default=0.0)


def _find_depth_range(tie_points: TiePoints, rig: Rig, residuals: FrameResiduals) -> tuple[float, float]:
    """Return the depths of the points that unguided matching found on their epipolar lines."""
    depths = [np.empty(0)]
    scale = tie_points.pixel_scale
    for name, residual in residuals.epipolar.items():
        if scale > 1 and residual.points >= LEAST_TIE_POINTS:
            pair = compute_pair_residuals(tie_points, rig, name)
            near = np.abs(pair.epipolar_px - residual.median_px) < 2 * scale
            depths.append(1 / pair.inverse_depth[near & (pair.inverse_depth > 0)])
    every = np.concatenate(depths)
    if len(every) < LEAST_TIE_POINTS:
        return float("nan"), float("nan")
    near_mm, far_mm = np.quantile(every, [0.05, 0.95])
    return float(near_mm), float(far_mm)
