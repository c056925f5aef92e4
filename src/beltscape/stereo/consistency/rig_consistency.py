"""Result of the camera consistency check: the state of each auxiliary, and what explains the contradictions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from beltscape.stereo.consistency.faults.pose_change import PoseChange
from beltscape.stereo.consistency.row_fit import RowFit
from beltscape.stereo.consistency.tie_points.tie_points import TiePoints

State = Literal["sound", "contradicting", "unmatched", "undecided", "not measured"]
"""State of an auxiliary:

sound           its points agree with the rig within the tolerance
contradicting   their systematic residuals exceed the tolerance
unmatched       it shows hardly any of the core's points
undecided       those that agree are outnumbered by those that have no match or another one
not measured    too few points were searched or found
"""


@dataclass(frozen=True, slots=True)
class CameraConsistency:
    """Consistency of one auxiliary camera with the rig."""

    camera: str
    state: State
    epipolar_px: float
    """Systematic epipolar residual, RMS over the image; NaN: not measured."""
    epipolar_sigma_px: float
    """One standard deviation of it."""
    disparity_px: float
    """Systematic disparity residual against the other auxiliaries, their median; NaN: not measured."""
    tolerance_px: float
    """Tolerance of the epipolar residual, from the rig's covariance and the matching."""
    points: int
    """Number of points found."""
    searched: int
    """Number of textured points that lie in its image."""
    agreement: float
    """Share of the searched points found within a pixel of their epipolar line; NaN: none searched."""
    depth_mm_per_px: float
    """Error of the depth that one pixel of error along the epipolar lines causes, mm; NaN without tie points."""
    rows: RowFit
    """The row error as a function of place."""
    failing: int = 0
    """Number of textured points in its view without a depth, or found off their epipolar lines."""

    @property
    def depth_error_mm(self) -> float:
        """Return the size of the residuals as an error of depth; NaN where they were not measured.

        The difference of two auxiliaries' disparities is normalised to one pixel of error in either image; a camera
        that is off by itself is off by √2 of it.
        """
        along = float(np.nan_to_num(self.disparity_px)) * float(np.sqrt(2))
        return float(np.hypot(self.epipolar_px, along)) * self.depth_mm_per_px


@dataclass(frozen=True, slots=True, eq=False)
class RigConsistency:
    """Consistency of a rig with the images of one frame, or of several."""

    cameras: tuple[CameraConsistency, ...]
    textured_points: int
    """Number of textured points of the core image."""
    guided: bool
    """Whether a depth map guided the matching."""
    ambiguous: bool
    """Whether the frame does not show which of the contradicting cameras is right."""
    core_moved: bool
    """Whether the core moved: every plausible explanation of the contradictions contains it."""
    pose_change: PoseChange | None
    """The pose change of one camera that explains the contradictions; None if there is none."""
    found_depth_range_mm: tuple[float, float]
    """Near and far end of the depths at which unguided matching found the points; NaN if too few."""
    misfit_px: float
    """Greatest excess of a systematic residual of the sound auxiliaries, or of all if none is sound."""
    tie_points: TiePoints
    """The matched points."""
    is_change: bool = False
    """Whether the residuals are those since a reference was taken."""
    suspects: tuple[str, ...] = ()
    """Cameras of which one moved, while the images do not show yet which; also the core."""
    is_searched: bool = False
    """Whether the points were also searched without the depth map."""

    @property
    def is_confirmed(self) -> bool:
        """Return whether every auxiliary is sound, by the depth map and by the search without it."""
        return self.is_searched and self.guided and len(self.find_auxiliaries("sound")) == len(self.cameras)

    def find_auxiliaries(self, *states: State) -> tuple[str, ...]:
        """Return the auxiliaries in one of the states."""
        return tuple(each.camera for each in self.cameras if each.state in states)

    @property
    def inconsistent(self) -> tuple[str, ...]:
        """Auxiliaries that contradict the rig or are unmatched."""
        return self.find_auxiliaries("contradicting", "unmatched")

    @property
    def is_sound(self) -> bool:
        """Return whether every auxiliary is consistent or was not measured."""
        return not self.inconsistent


def make_consistency_document(consistency: RigConsistency) -> Mapping[str, object]:
    """Return the consistency as plain values for JSON."""
    change = consistency.pose_change
    return {
        "textured_points": consistency.textured_points,
        "guided_by_depth": consistency.guided,
        "core_moved": consistency.core_moved,
        "ambiguous": consistency.ambiguous,
        "suspects": list(consistency.suspects),
        "misfit_px": consistency.misfit_px,
        "motion": change
        and {
            "camera": change.camera,
            "angle_deg": change.angle_deg,
            "angle_sigma_deg": change.angle_sigma_deg,
            "shift_mm": change.shift_mm,
            "shift_sigma_mm": change.shift_sigma_mm,
        },
        "cameras": [
            {
                "camera": each.camera,
                "state": each.state,
                "epipolar_px": each.epipolar_px,
                "epipolar_sigma_px": each.epipolar_sigma_px,
                "along_px": each.disparity_px,
                "allowed_px": each.tolerance_px,
                "points": each.points,
                "searched": each.searched,
                "agreement": each.agreement,
                "failing": each.failing,
                "row_error": {
                    "offset_px": each.rows.offset_px,
                    "slope_x_px": each.rows.slope_x_px,
                    "slope_y_px": each.rows.slope_y_px,
                    "depth_px": each.rows.depth_px,
                    "rms_px": each.rows.rms_px,
                    "sigma_px": each.rows.sigma_px,
                    "points": each.rows.explained,
                },
                "depth_error_mm": each.depth_error_mm,
            }
            for each in consistency.cameras
        ],
    }
