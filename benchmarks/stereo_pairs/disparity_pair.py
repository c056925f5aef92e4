"""A rectified stereo pair with dense true disparity, and the scores of a depth map against it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig

GROSS_PX = 4.0
"""A larger error is a false match; the limit "bad 4.0" of Middlebury's evaluation."""


@dataclass(frozen=True, slots=True)
class DisparityScore:
    """Scores of a depth map against true disparity; NaN for an empty set of pixels."""

    pixels: int
    """Pixels that have a true disparity."""
    coverage: float
    """Share of them that was measured, 0..1."""
    within_half_px: float
    """Share of ALL of them with an error below 0.5 px; an unmeasured pixel counts as wrong."""
    within_1px: float
    within_2px: float
    median_px: float
    """Median absolute error of the measured pixels."""
    gross: float
    """Share of the measured pixels with an error above 4 px."""


@dataclass(frozen=True, slots=True, eq=False)
class DisparityPair:
    """Two parallel pinhole cameras without distortion, their images, and the core's true disparity."""

    name: str
    rig: Rig
    frame_set: FrameSet
    depth_range_mm: tuple[float, float]
    """(near, far) depth range of the scene along the core's optical axis."""
    disparity_px: NDArray[np.float64]
    """(H, W) u_core − u_aux, px; NaN: unknown."""

    def score(self, depth: DepthMap, region: NDArray[np.bool_] | None = None) -> DisparityScore:
        """Compare a depth map with the truth, in all pixels or in a region (H, W)."""
        if depth.depth_mm.shape != self.disparity_px.shape:
            raise InputError(
                f"the truth is {self.disparity_px.shape}, the depth map {depth.depth_mm.shape} pixels"
            )
        valid = np.isfinite(self.disparity_px)
        valid = valid if region is None else valid & region
        error = np.abs(self.disparity_from_depth(depth) - self.disparity_px)[valid]
        finite = error[np.isfinite(error)]
        return DisparityScore(
            pixels=error.size,
            coverage=_share(finite.size, error.size),
            within_half_px=_share((finite < 0.5).sum(), error.size),
            within_1px=_share((finite < 1).sum(), error.size),
            within_2px=_share((finite < 2).sum(), error.size),
            median_px=float(np.median(finite)) if finite.size else np.nan,
            gross=_share((finite > GROSS_PX).sum(), finite.size),
        )

    def disparity_from_depth(self, depth: DepthMap) -> NDArray[np.float64]:
        """Return the disparity (H, W), px, of a depth map; NaN: none."""
        core, name = self.rig.core_camera, self.rig.auxiliaries[0]
        baseline_mm = float(self.rig.cam_from_core[name].center_mm[0])
        shift_px = float(self.rig.cameras[name].center_px[0] - core.center_px[0])
        return core.focal_px[0] * baseline_mm / depth.depth_mm.astype(np.float64) - shift_px

    def covisible_mask(self) -> NDArray[np.bool_]:
        """Return the mask (H, W) of true points that are visible in the auxiliary's image."""
        height, width = self.disparity_px.shape
        column = np.arange(int(width)) - self.disparity_px
        place = np.rint(np.where(np.isfinite(column), column, -1)).astype(np.intp)
        inside = (place >= 0) & (place < width)
        rows, _ = np.nonzero(inside)
        nearest = np.full((height, width), -np.inf)
        np.maximum.at(nearest, (rows, place[inside]), self.disparity_px[inside])
        seen = np.zeros((height, width), bool)
        seen[inside] = self.disparity_px[inside] > nearest[rows, place[inside]] - 1
        return seen


def _share(part: int | np.integer, whole: int) -> float:
    return float(part) / whole if whole else np.nan
