"""Detected corners, views and frames that the final rig was not found from, with the largest reason."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.assessment.validation.score import project_board
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibration.hierarchy import HierarchyResult
from beltscape.calibration.network.resection import fit_board_pose
from beltscape.core.errors import CalibrationError


@dataclass(frozen=True, slots=True, eq=False)
class Discards:
    """Views and corners that were left out of the final adjustment."""

    corners: int
    """Corners left out, those of whole views and frames included."""
    all_corners: int
    views: tuple[tuple[str, str], ...]
    """(camera, frame) of the views left out as a whole, those of whole frames included."""
    all_views: int
    frames: Mapping[str, str]
    """Frame left out in all cameras → the reason."""
    all_frames: int

    def describe(self) -> str:
        """Return the counts with the largest reason in one line."""
        if not self.corners:
            return "nothing left out"
        return (
            f"left out: {self.corners} of {self.all_corners} corners, {len(self.views)} of {self.all_views} views, "
            f"{len(self.frames)} of {self.all_frames} frames; {self._describe_reason()}"
        )

    def _describe_reason(self) -> str:
        if self.frames:
            return "; ".join(self.frames.values())
        if not self.views:
            return "single corners that miss the rig by more than 4.5 σ"
        cameras = [camera for camera, _ in self.views]
        most = max(dict.fromkeys(cameras), key=cameras.count)
        own = [frame for camera, frame in self.views if camera == most]
        return f"most views from camera {most}: {', '.join(own[:6])}{' …' * (len(own) > 6)}"

    def document(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return {
            "corners": self.corners,
            "of_corners": self.all_corners,
            "views": [list(view) for view in self.views],
            "of_views": self.all_views,
            "frames": dict(self.frames),
            "of_frames": self.all_frames,
            "words": self.describe(),
        }


def find_discards(hierarchy: HierarchyResult, adjustment: BundleAdjustmentResult) -> Discards:
    """Return the detected corners of the rig's cameras that the final adjustment did not use."""
    used = _count_used_corners(adjustment)
    detected = {
        (name, frame): len(corners)
        for name in adjustment.rig.cameras
        for frame, corners in hierarchy.detections.views[name].items()
    }
    views = tuple(view for view in detected if not used.get(view))
    used_frames = {frame for (_, frame), count in used.items() if count}
    frames = dict.fromkeys(frame for _, frame in detected if frame not in used_frames)
    return Discards(
        corners=sum(detected.values()) - sum(used.values()),
        all_corners=sum(detected.values()),
        views=views,
        all_views=len(detected),
        frames={frame: _describe_frame(frame, hierarchy, adjustment) for frame in frames},
        all_frames=len({frame for _, frame in detected}),
    )


def _count_used_corners(adjustment: BundleAdjustmentResult) -> dict[tuple[str, str], int]:
    """Return (camera, frame) → corners that the final adjustment used."""
    observed, names = adjustment.bundle.observations, list(adjustment.rig.cameras)
    view = observed.camera * len(adjustment.frames) + observed.frame
    counts = np.bincount(view[adjustment.used], minlength=len(names) * len(adjustment.frames))
    return {
        (name, frame): int(counts[i * len(adjustment.frames) + k])
        for i, name in enumerate(names)
        for k, frame in enumerate(adjustment.frames)
    }


def _describe_frame(frame: str, hierarchy: HierarchyResult, adjustment: BundleAdjustmentResult) -> str:
    """Return why a whole frame was left out, in one line."""
    rms_px, others_px = _compute_frame_rms(frame, hierarchy, adjustment), _compute_used_rms(adjustment)
    return (
        f"frame {frame} is left out in all cameras: its board fits {rms_px / others_px:.0f} times worse than in the "
        f"other frames ({rms_px:.2g} px against {others_px:.2g} px); it was bent or moved, or its corners are "
        "numbered wrongly"
    )


def _compute_frame_rms(frame: str, hierarchy: HierarchyResult, adjustment: BundleAdjustmentResult) -> float:
    """Return the RMS of a frame's residuals under the final rig, px; NaN if no pose fits it."""
    views = {
        name: hierarchy.detections.views[name][frame]
        for name in adjustment.rig.cameras
        if frame in hierarchy.detections.views[name]
    }
    points = adjustment.geometry.points_mm
    try:
        pose = fit_board_pose(adjustment.rig, views, points)
    except CalibrationError:
        return float("nan")
    errors: NDArray[np.float64] = np.concatenate(
        [c.pixels - project_board(adjustment.rig, n, pose, points[c.ids]) for n, c in views.items()]
    )
    squares: NDArray[np.float64] = (errors**2).sum(axis=1)
    return float(np.sqrt(np.nanmean(squares)))


def _compute_used_rms(adjustment: BundleAdjustmentResult) -> float:
    errors = adjustment.bundle.compute_errors_px(adjustment.geometry)[adjustment.used]
    return float(np.sqrt((errors**2).sum(axis=1).mean()))
