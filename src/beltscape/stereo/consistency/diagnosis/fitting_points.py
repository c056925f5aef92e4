"""Number of points of a frame whose matches lie where the rig predicts them, as it is or with changed images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np

from beltscape.core.frames import FrameSet, Image
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.faults.isolation import compute_frame_residuals
from beltscape.stereo.consistency.residuals import compute_pair_residuals
from beltscape.stereo.consistency.tie_points.tie_points import TiePoints, detect_textured_points
from beltscape.stereo.consistency.tie_points.unguided_matching import UnguidedMatcher
from beltscape.stereo.multiview.initialisation.depth_range import compute_search_range

_FITS_PX = 1.0
"""Greatest systematic residual of a camera that fits, px of the small images."""
_LEAST_INLIERS = 0.6
"""Least share of inliers of a camera that fits."""
_POINTS = 150
"""Number of points that distinguishes a camera that fits from one that does not."""


class FittingPoints:
    """Counts the points of one frame that fit the rig; the rig's pairs are rectified once for all counts."""

    def __init__(self, frame_set: FrameSet, rig: Rig) -> None:
        self.frame_set, self.rig = frame_set, rig
        self.auxiliaries = tuple(name for name in rig.auxiliaries if name in frame_set.images)
        """The auxiliaries that have an image in the frame."""

    @cached_property
    def unchanged(self) -> dict[str, int]:
        """The points that fit by auxiliary, with the images as they are."""
        return self.count(self.frame_set, self.auxiliaries)

    def count_with(self, changed: Mapping[str, Image]) -> dict[str, int]:
        """Return by auxiliary the points that fit with these images by camera in place of the frame's own."""
        affected = self.auxiliaries if self.rig.core in changed else tuple(changed)
        frame_set = replace(self.frame_set, images={**self.frame_set.images, **changed})
        return {**self.unchanged, **self.count(frame_set, affected)}

    def count(self, frame_set: FrameSet, names: tuple[str, ...]) -> dict[str, int]:
        """Return by auxiliary the number of points on their epipolar lines; 0 for one that does not fit."""
        tie_points = self._match(frame_set, names)
        epipolar = compute_frame_residuals(tie_points, self.rig, names).epipolar
        return {
            name: residual.points
            if np.isfinite(residual.rms_px)
            and residual.inlier_share > _LEAST_INLIERS
            and residual.rms_px < _FITS_PX * tie_points.pixel_scale
            else 0
            for name, residual in epipolar.items()
        }

    def measure_agreement(self, frame_set: FrameSet, names: tuple[str, ...]) -> float:
        """Return the share of the searched points that lie on their epipolar lines, as a mean over auxiliaries."""
        tie_points, shares = self._match(frame_set, names), list[float]()
        for name in names:
            epipolar = compute_pair_residuals(tie_points, self.rig, name).epipolar_px
            agreeing = (np.abs(epipolar) < _FITS_PX * tie_points.pixel_scale).sum()
            shares.append(float(agreeing) / max(int(tie_points.searched[name].sum()), 1))
        return float(np.mean(shares))

    def _match(self, frame_set: FrameSet, names: tuple[str, ...]) -> TiePoints:
        image, camera = frame_set.images[self.rig.core], self.rig.core_camera
        return self._matcher.match(
            frame_set, names, detect_textured_points(image, camera, max_points=_POINTS)
        )

    @cached_property
    def _matcher(self) -> UnguidedMatcher:
        return UnguidedMatcher(self.rig, compute_search_range(self.rig, self.auxiliaries))
