"""Consistency check of the cameras of one frame: the images against the rig and, if there is one, the depth map.

Where the textured points that fail to agree with the rig outnumber those that agree, a camera is not sound. Tie
points are accumulated over frames: small movements become significant, and changes are seen by themselves.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.statistics import compute_median, drop_nan
from beltscape.stereo.consistency.isolation import (
    Attribution,
    FaultIsolation,
    FrameData,
    FrameResiduals,
    attribute_faults,
    compute_frame_residuals,
    exceeds_tolerance,
    isolate_faults,
)
from beltscape.stereo.consistency.residuals import (
    PairResiduals,
    ResidualReference,
    compute_pair_residuals,
    compute_reference,
)
from beltscape.stereo.consistency.rig_consistency import (
    NO_FIT,
    CameraConsistency,
    RigConsistency,
    RowFit,
    State,
    fit_rows,
)
from beltscape.stereo.consistency.tie_points import (
    Array,
    TiePoints,
    detect_textured_points,
    join_tie_points,
    make_unguided_matcher,
    match_guided,
)
from beltscape.stereo.consistency.tolerance import Tolerance, compute_change_tolerance, compute_tolerance
from beltscape.stereo.multiview.depth_range import compute_search_range

AGREES_PX = 1.0
"""A point agrees with the rig within this distance from its epipolar line, px of the matched images."""


def find_undecided(
    consistency: RigConsistency,
    rig: Rig,
    depth: DepthMap | None,
    points: Array,
    searched: TiePoints | None = None,
) -> RigConsistency:
    """Return the consistency with "undecided" for sound auxiliaries in which more points fail than agree.

    A textured point (N, 2) in an auxiliary's view fails where the depth map has no depth and the search without it,
    ``searched``, finds it nowhere on its epipolar line, and where it is found off that line. A point with a depth
    that is not found again lies on an edge or behind one, as on heaps of stones, and says nothing.
    """
    if depth is None or not depth.measured.any():
        return consistency
    is_lost = ~_is_measured(depth, points)
    rays = (points - rig.core_camera.center_px) / rig.core_camera.focal_px
    surface = np.column_stack([rays, np.ones(len(rays))]) * compute_median(drop_nan(depth.depth_mm))
    cameras: list[CameraConsistency] = []
    for each in consistency.cameras:
        camera = rig.cameras[each.camera]
        pixels = camera.project(rig.cam_from_core[each.camera].apply(surface))
        is_lost_here = is_lost & ((pixels >= 0) & (pixels <= np.array(camera.size_px) - 1)).all(axis=1)
        agreeing = found = round(np.nan_to_num(each.agreement) * each.searched)
        if searched is not None:
            on_line = _is_on_line(searched, rig, each.camera)
            agreeing += int((is_lost_here & on_line).sum()) if consistency.guided else 0
            is_lost_here &= ~on_line
        failing = int(is_lost_here.sum()) + (each.points - found if consistency.guided else 0)
        is_open = each.state == "sound" and failing > agreeing
        cameras.append(replace(each, failing=failing, state="undecided" if is_open else each.state))
    return replace(consistency, cameras=tuple(cameras))


def _is_measured(depth: DepthMap, points: Array) -> NDArray[np.bool_]:
    """Return (N,) whether there is a depth at or beside each point (N, 2)."""
    measured = cv2.dilate(depth.measured.astype(np.uint8), np.ones((5, 5), np.uint8))
    column, row = np.rint(points).astype(np.int64).T
    return np.asarray(measured[row, column] > 0, np.bool_)


def _is_on_line(tie_points: TiePoints, rig: Rig, name: str) -> NDArray[np.bool_]:
    """Return (N,) which points were found on their epipolar lines in an auxiliary's image."""
    epipolar = compute_pair_residuals(tie_points, rig, name).epipolar_px
    return np.asarray(np.abs(epipolar) < AGREES_PX * tie_points.pixel_scale, np.bool_)


LEAST_COVERAGE = 0.3
"""A depth map with less coverage is not used for guided matching: its few pixels are chance matches."""
LEAST_TIE_POINTS = 30
"""With fewer tie points in the depth map, unguided matching is used."""
_BETTER = 1.2
"""The wide search replaces guided matching where it explains this many times its points: on sound rigs it explains
half to 0.8 of them, with focal lengths off by 1 % under sparse dots 1.6 to 2.6 times as many, since a wrong depth map
guides to chance matches only."""
_STILL_CONFIRMED = 0.5
"""The wide search is left out while guided matching explains this share of the points of the last confirmed frame."""


def check_consistency(
    frame_set: FrameSet,
    rig: Rig,
    depth: DepthMap | None,
    auxiliaries: tuple[str, ...] | None = None,
    tolerance: Tolerance | None = None,
    confirmed: RigConsistency | None = None,
) -> RigConsistency:
    """Measure how well each auxiliary's image agrees with the rig and with the depth that the others give.

    Points are matched where the depth map predicts them, and by a wide search that does not use it: a depth map under
    a wrong rig predicts chance matches, which agree with it. Those matches are assessed with which more of the
    image's textured points agree. An auxiliary in which points without agreement outnumber the others is "undecided".

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
    confirmed
        A sound consistency of an earlier frame; the wide search is left out while about as many points agree.
    """
    names = tuple(n for n in auxiliaries or rig.auxiliaries if n in frame_set.images)
    points = detect_textured_points(frame_set.images[rig.core], rig.core_camera)
    guided, found = _match_guided(frame_set, rig, names, depth, points), None
    if guided is not None:
        found = assess_tie_points(guided, rig, names, tolerance or _make_tolerance(guided, rig, names))
        found = replace(found, textured_points=len(points))
        if _is_still_confirmed(found, confirmed):
            return find_undecided(found, rig, depth, points)
    matcher = make_unguided_matcher(rig, compute_search_range(rig, names))
    wide_points = matcher.match(frame_set, names, points)
    tolerance = tolerance or _make_tolerance(wide_points, rig, names)
    wide = assess_tie_points(wide_points, rig, names, tolerance.widen(wide_points.pixel_scale))
    wide = replace(wide, textured_points=len(points), guided=False, is_searched=True)
    chosen = wide if found is None else _choose(found, wide)
    return find_undecided(chosen, rig, depth, points, wide_points)


def _make_tolerance(tie_points: TiePoints, rig: Rig, names: tuple[str, ...]) -> Tolerance:
    """Return the tolerance at the depth of the tie points, or in the middle of the search range without any."""
    if len(tie_points.inverse_depth):
        return compute_tolerance(rig, float(1 / np.median(tie_points.inverse_depth)))
    return compute_tolerance(rig, sum(compute_search_range(rig, names)) / 2)


def _is_still_confirmed(guided: RigConsistency, confirmed: RigConsistency | None) -> bool:
    """Return whether guided matching explains nearly as many points as when the wide search confirmed the rig."""
    if confirmed is None:
        return False
    before = {each.camera: each.rows.explained for each in confirmed.cameras}
    return guided.is_sound and all(
        each.camera in before and each.rows.explained >= _STILL_CONFIRMED * before[each.camera]
        for each in guided.cameras
    )


def _choose(guided: RigConsistency, wide: RigConsistency) -> RigConsistency:
    """Return the consistency whose matches agree with more textured points; the guided one in case of doubt."""
    pairs = list(zip(guided.cameras, wide.cameras, strict=True))
    if any(
        other.rows.explained > _BETTER * max(one.rows.explained, LEAST_TIE_POINTS) for one, other in pairs
    ):
        return wide
    return replace(guided, is_searched=True)


def assess_tie_points(
    tie_points: TiePoints,
    rig: Rig,
    names: tuple[str, ...],
    tolerance: Tolerance,
    reference: ResidualReference | None = None,
) -> RigConsistency:
    """Return the consistency of auxiliaries by the tie points of one or more frames.

    With a ``reference`` the residuals are those in excess of it, and the tolerance is that of their change. A rig
    that does not state how well it is known gets a looser one, unless its other cameras show it.
    """
    residuals = compute_frame_residuals(tie_points, rig, names, reference)
    isolation = isolate_faults(tie_points, residuals, tolerance)
    attribution = Attribution(isolation)
    if isolation.contradicting:
        data = FrameData(tie_points, rig, residuals, tolerance, reference)
        attribution = attribute_faults(data, isolation)
        if not (
            tolerance.is_stated or attribution.has_result or isolation.find_confirmed(residuals.epipolar)
        ):
            return assess_tie_points(tie_points, rig, names, tolerance.loosen(), reference)
        isolation = attribution.isolation
    cameras = tuple(_assess_camera(name, tie_points, rig, residuals, isolation, tolerance) for name in names)
    return RigConsistency(
        cameras,
        len(tie_points.core_px),
        True,
        isolation.ambiguous,
        attribution.core_moved,
        attribution.pose_change,
        _find_depth_range(tie_points, residuals),
        _compute_misfit(residuals, () if attribution.suspects else isolation.sound),
        tie_points,
        reference is not None,
        attribution.suspects,
    )


def _match_guided(
    frame_set: FrameSet, rig: Rig, names: tuple[str, ...], depth: DepthMap | None, points: Array
) -> TiePoints | None:
    """Return the tie points that the depth map guides to; None without a map, or where it holds too few points."""
    if depth is None or depth.coverage < LEAST_COVERAGE:
        return None
    tie_points = match_guided(frame_set, rig, names, depth, points)
    return tie_points if len(tie_points.core_px) >= LEAST_TIE_POINTS else None


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
    pair_residuals = residuals.points[name]
    agreeing = int((np.abs(pair_residuals.epipolar_px) < AGREES_PX * tie_points.pixel_scale).sum())
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
        _fit_rows(tie_points, rig, pair_residuals),
    )


def _fit_rows(tie_points: TiePoints, rig: Rig, residuals: PairResiduals) -> RowFit:
    """Return the row error as a function of place."""
    if not len(tie_points.core_px):
        return NO_FIT
    return fit_rows(
        residuals.epipolar_px,
        tie_points.core_px,
        residuals.inverse_depth,
        rig.core_camera.size_px,
        tie_points.pixel_scale,
    )


def _compute_depth_error(tie_points: TiePoints, residuals: PairResiduals) -> float:
    """Return the error of the depth per pixel along the epipolar lines of an auxiliary, mm, as a median."""
    if not len(tie_points.core_px):
        return float("nan")
    inverse_depth = residuals.inverse_depth[residuals.inverse_depth > 0]
    middle = float(np.median(inverse_depth if len(inverse_depth) else tie_points.inverse_depth))
    return float(np.median(1 / (middle**2 * residuals.sensitivity_px_mm)))


def _compute_misfit(residuals: FrameResiduals, sound: tuple[str, ...]) -> float:
    """Return the greatest excess of a systematic residual among the sound auxiliaries, or all without any, px."""
    measured = tuple(name for name in sound if np.isfinite(residuals.epipolar[name].rms_px))
    names = measured or tuple(residuals.epipolar)
    own = [residuals.epipolar[name] for name in names]
    own += [residual for pair, residual in residuals.disparity.items() if set(pair) <= set(names)]
    return max((residual.excess_px for residual in own), default=0.0)


def _find_depth_range(tie_points: TiePoints, residuals: FrameResiduals) -> tuple[float, float]:
    """Return the depths of the points that unguided matching found on their epipolar lines."""
    depths = [np.empty(0)]
    scale = tie_points.pixel_scale
    for name, residual in residuals.epipolar.items():
        if scale > 1 and residual.points >= LEAST_TIE_POINTS:
            pair = residuals.points[name]
            near = np.abs(pair.epipolar_px - residual.median_px) < 2 * scale
            depths.append(1 / pair.inverse_depth[near & (pair.inverse_depth > 0)])
    every = np.concatenate(depths)
    if len(every) < LEAST_TIE_POINTS:
        return float("nan"), float("nan")
    near_mm, far_mm = np.quantile(every, [0.05, 0.95])
    return float(near_mm), float(far_mm)


POOLED_FRAMES = 4
"""Number of frames that are assessed together; after a movement, the medians show it once most are newer than it."""
REFERENCE_FRAMES = 10
"""Number of sound frames from which the reference is taken."""


class ResidualAccumulator:
    """Assesses the tie points of the last checked frames, against the rig and against the first sound frames."""

    def __init__(self, rig: Rig, depth_mm: float) -> None:
        """``depth_mm`` is the depth at which the rig's covariance is converted to tolerances."""
        self._rig = rig
        self._tolerance = compute_tolerance(rig, depth_mm, pooled=True)
        self._change_tolerance = compute_change_tolerance(rig)
        self._frames: deque[TiePoints] = deque(maxlen=POOLED_FRAMES)
        self._first: list[TiePoints] = []
        self._reference: ResidualReference | None = None

    @property
    def has_reference(self) -> bool:
        """Return whether enough sound frames were seen to measure changes."""
        return self._reference is not None

    def add(self, tie_points: TiePoints) -> None:
        """Add the tie points of a frame that is consistent by itself."""
        self._frames.append(tie_points)
        if self._reference is None:
            self._first.append(tie_points)
        if self._reference is None and len(self._first) >= REFERENCE_FRAMES:
            if self.assess() is None:
                joined = join_tie_points(self._first)
                self._reference = compute_reference(joined, self._rig, tuple(joined.observed_px))
            self._first = []

    def assess(self) -> RigConsistency | None:
        """Return the contradiction that the last frames show together; None if they show none or are too few."""
        if len(self._frames) < POOLED_FRAMES:
            return None
        joined = join_tie_points(list(self._frames))
        names = tuple(name for name in self._rig.auxiliaries if name in joined.observed_px)
        contradiction = self._find_contradiction(joined, names, self._tolerance, None)
        if contradiction is None and self._reference is not None:
            return self._find_contradiction(joined, names, self._change_tolerance, self._reference)
        return contradiction

    def _find_contradiction(
        self,
        tie_points: TiePoints,
        names: tuple[str, ...],
        tolerance: Tolerance,
        reference: ResidualReference | None,
    ) -> RigConsistency | None:
        """Return the consistency of tie points if they contradict the rig or the reference; None if not.

        Most do not, which their residuals show already.
        """
        residuals = compute_frame_residuals(tie_points, self._rig, names, reference)
        isolation = isolate_faults(tie_points, residuals, tolerance)
        if not (isolation.contradicting or isolation.unmatched):
            return None
        consistency = assess_tie_points(tie_points, self._rig, names, tolerance, reference)
        return None if consistency.is_sound else consistency

    def is_suspect(self, tie_points: TiePoints) -> bool:
        """Return whether one frame leaves more than half of what a change may leave; it then proves nothing."""
        if self._reference is None:
            return False
        names = tuple(name for name in self._rig.auxiliaries if name in tie_points.observed_px)
        residuals = compute_frame_residuals(tie_points, self._rig, names, self._reference)
        tolerance = self._change_tolerance
        return any(
            exceeds_tolerance(residual, 0.5 * tolerance.epipolar_px[name])
            for name, residual in residuals.epipolar.items()
        ) or any(
            exceeds_tolerance(residual, 0.5 * tolerance.disparity_px[pair])
            for pair, residual in residuals.disparity.items()
        )
