"""Accumulation of tie points over frames: small movements become significant, and changes are seen by themselves."""

from __future__ import annotations

from collections import deque

from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.check import assess_tie_points
from beltscape.stereo.consistency.faults.isolation import compute_frame_residuals, exceeds_tolerance
from beltscape.stereo.consistency.residual_reference import ResidualReference, compute_reference
from beltscape.stereo.consistency.rig_consistency import RigConsistency
from beltscape.stereo.consistency.tie_points.tie_points import TiePoints, join_tie_points
from beltscape.stereo.consistency.tolerance import compute_change_tolerance, compute_tolerance

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
        consistency = assess_tie_points(joined, self._rig, names, self._tolerance)
        if consistency.is_sound and self._reference is not None:
            consistency = assess_tie_points(joined, self._rig, names, self._change_tolerance, self._reference)
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
