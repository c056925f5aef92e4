"""Camera consistency of one frame: images, rig and, where there is one, the depth map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet
from beltscape.core.rig import Rig
from beltscape.stereo.consistency.allowance import Allowance, allowance_of
from beltscape.stereo.consistency.guided import guided_points
from beltscape.stereo.consistency.isolation import Isolation, Residuals, exceeds, isolate, residuals_of
from beltscape.stereo.consistency.motion import Motion, fit_motion
from beltscape.stereo.consistency.residuals import pair_residuals
from beltscape.stereo.consistency.tie_points import TiePoints, textured_points
from beltscape.stereo.consistency.unguided import unguided_points
from beltscape.stereo.multiview.initialisation.depth_range import search_range

State = Literal["sound", "contradicting", "unmatched", "not measured"]

LEAST_COVERAGE = 0.3
"""A sparser depth map guides no search: what little it holds is where images agree by chance."""
LEAST_POINTS = 30
"""With fewer tie points the search is made without the depth map."""
_AGREES_PX = 1.0
"""A point agrees with the rig within this distance from its epipolar line."""
_EXPLAINED = 2.0
"""A motion explains residuals that it brings within so many allowances."""


@dataclass(frozen=True, slots=True)
class CameraConsistency:
    """What one frame says of an auxiliary camera."""

    camera: str
    state: State
    epipolar_px: float
    """Systematic distance of its points from their epipolar lines, RMS over the image; NaN: not measured."""
    epipolar_sigma_px: float
    """One standard deviation of it."""
    along_px: float
    """Systematic difference of its depths from those of the other auxiliaries, as px; NaN: not measured."""
    allowed_px: float
    """What the rig's covariance and the search allow across the epipolar line."""
    points: int
    """Correspondences found."""
    searched: int
    """Textured points that lie in its image."""
    agreement: float
    """Share of the searched points found within a pixel of their epipolar line; NaN: none searched."""


@dataclass(frozen=True, slots=True, eq=False)
class RigConsistency:
    """What one frame says of a rig."""

    cameras: tuple[CameraConsistency, ...]
    textured: int
    """Textured points of the core image."""
    guided: bool
    """Whether a depth map guided the search."""
    ambiguous: bool
    """Whether the frame cannot say which of the cameras that contradict each other is right."""
    core_moved: bool
    """Whether a movement of the core alone explains what contradicts."""
    motion: Motion | None
    """The movement that explains the contradiction, where one camera's does."""
    depths_mm: tuple[float, float]
    """Near and far end of the depths at which an unguided search found the points; NaN where there are none."""
    misfit_px: float
    """Greatest systematic residual of the sound auxiliaries, or of all where none is, beyond what matching leaves."""

    def named(self, *states: State) -> tuple[str, ...]:
        """Return the auxiliaries in one of the states."""
        return tuple(each.camera for each in self.cameras if each.state in states)

    @property
    def doubtful(self) -> tuple[str, ...]:
        """Auxiliaries that contradict the rig or match nothing."""
        return self.named("contradicting", "unmatched")

    @property
    def is_sound(self) -> bool:
        """Whether no camera is in doubt."""
        return not self.doubtful


def camera_consistency(
    frame_set: FrameSet,
    rig: Rig,
    depth: DepthMap | None,
    auxiliaries: tuple[str, ...] | None = None,
    allowance: Allowance | None = None,
) -> RigConsistency:
    """Measure how well each auxiliary's image agrees with the rig and with the depth that the others give.

    Parameters
    ----------
    frame_set
        The core's image and at least one auxiliary's.
    rig
        The rig that is to be checked.
    depth
        Depth of the frame under this rig. Without it, or where it is sparse, the correspondences are searched in
        small rectified images, which measures to about half a pixel of theirs.
    auxiliaries
        Which to check; those that have an image by default.
    allowance
        Of `allowance_of`, for many frames of one rig.
    """
    names = tuple(n for n in auxiliaries or rig.auxiliaries if n in frame_set.images)
    points = textured_points(frame_set.images[rig.core], rig.core_camera)
    tie, guided = _tie_points(frame_set, rig, names, depth, points)
    if allowance is None:
        allowance = allowance_of(
            rig,
            float(1 / np.median(tie.inverse_depth))
            if len(tie.inverse_depth)
            else sum(search_range(rig, names)) / 2,
        )
    if not guided:
        allowance = allowance.widened(tie.pixel)
    residuals = residuals_of(tie, rig, names)
    found = isolate(tie, residuals, allowance)
    core_moved, motion = False, None
    if found.contradicting or found.unmatched:
        motion = _explanation(tie, rig, residuals, found, allowance)
        core_moved = motion is not None and motion.camera == rig.core
    cameras = tuple(_camera(name, tie, rig, residuals, found, allowance, core_moved) for name in names)
    return RigConsistency(
        cameras,
        len(points),
        guided,
        found.ambiguous and not core_moved,
        core_moved,
        motion,
        _depths(tie, rig, residuals),
        _misfit(residuals, tuple(c.camera for c in cameras if c.state == "sound") or names),
    )


def _tie_points(
    frame_set: FrameSet, rig: Rig, names: tuple[str, ...], depth: DepthMap | None, points: np.ndarray
) -> tuple[TiePoints, bool]:
    if depth is not None and depth.coverage >= LEAST_COVERAGE:
        tie = guided_points(frame_set, rig, names, depth, points)
        if len(tie.core_px) >= LEAST_POINTS:
            return tie, True
    return unguided_points(frame_set, rig, names, search_range(rig, names), points), False


def _explanation(
    tie: TiePoints, rig: Rig, residuals: Residuals, found: Isolation, allowance: Allowance
) -> Motion | None:
    """The movement of one camera that explains the frame: the auxiliary alone at fault, or else the core."""
    measured = (name for name, trend in residuals.across.items() if np.isfinite(trend.rms_px))
    names = tuple(name for name in measured if name not in found.unmatched)
    if len(names) < 2 or (found.unmatched and not found.contradicting):
        return None
    alone = found.contradicting if len(found.contradicting) == 1 else ()
    for camera in (*alone, *((rig.core,) if len(found.contradicting) > 1 and len(names) > 2 else ())):
        motion = fit_motion(tie, rig, camera, names)
        after = residuals_of(tie, motion.rig, names)
        if not any(exceeds(after.across[n], _EXPLAINED * allowance.across_px[n]) for n in names) and not any(
            exceeds(trend, _EXPLAINED * allowance.between_px[pair]) for pair, trend in after.between.items()
        ):
            return motion
    return None


def _camera(
    name: str,
    tie: TiePoints,
    rig: Rig,
    residuals: Residuals,
    found: Isolation,
    allowance: Allowance,
    core_moved: bool,
) -> CameraConsistency:
    across = residuals.across[name]
    searched = int(tie.searched[name].sum())
    values = pair_residuals(tie, rig, name).across_px
    agreeing = int((np.abs(values) < _AGREES_PX * tie.pixel).sum())
    partners = [n for n in found.sound if n != name] or [n for n in residuals.across if n != name]
    along = [
        trend.rms_px
        for pair, trend in residuals.between.items()
        if name in pair and any(n in pair for n in partners) and np.isfinite(trend.rms_px)
    ]
    state: State = "not measured" if not np.isfinite(across.rms_px) else "sound"
    if name in found.unmatched:
        state = "unmatched"
    elif name in found.contradicting or (core_moved and state == "sound"):
        state = "contradicting"
    return CameraConsistency(
        name,
        state,
        across.rms_px,
        across.sigma_px,
        float(np.median(along)) if along else float("nan"),
        allowance.across_px[name],
        across.points,
        searched,
        agreeing / searched if searched else float("nan"),
    )


def _misfit(residuals: Residuals, names: tuple[str, ...]) -> float:
    """Greatest systematic residual among some auxiliaries, px, without what matching alone leaves."""
    trends = [residuals.across[name] for name in names]
    trends += [trend for pair, trend in residuals.between.items() if set(pair) <= set(names)]
    return max((trend.excess_px for trend in trends), default=0.0)


def _depths(tie: TiePoints, rig: Rig, residuals: Residuals) -> tuple[float, float]:
    """Depths of the points on their epipolar lines that an unguided search found."""
    found = [np.empty(0)]
    for name, trend in residuals.across.items():
        if tie.pixel > 1 and trend.points >= LEAST_POINTS:
            each = pair_residuals(tie, rig, name)
            near = np.abs(each.across_px - trend.median_px) < 2 * tie.pixel
            found.append(1 / each.inverse_depth[near & (each.inverse_depth > 0)])
    every = np.concatenate(found)
    if len(every) < LEAST_POINTS:
        return float("nan"), float("nan")
    near_mm, far_mm = np.quantile(every, [0.05, 0.95])
    return float(near_mm), float(far_mm)


def consistency_document(consistency: RigConsistency) -> Mapping[str, object]:
    """Return it as plain values for JSON."""
    motion = consistency.motion
    return {
        "textured_points": consistency.textured,
        "guided_by_depth": consistency.guided,
        "core_moved": consistency.core_moved,
        "ambiguous": consistency.ambiguous,
        "misfit_px": consistency.misfit_px,
        "motion": motion
        and {"camera": motion.camera, "angle_deg": motion.angle_deg, "shift_mm": motion.shift_mm},
        "cameras": [
            {
                "camera": each.camera,
                "state": each.state,
                "epipolar_px": each.epipolar_px,
                "epipolar_sigma_px": each.epipolar_sigma_px,
                "along_px": each.along_px,
                "allowed_px": each.allowed_px,
                "points": each.points,
                "searched": each.searched,
                "agreement": each.agreement,
            }
            for each in consistency.cameras
        ],
    }
