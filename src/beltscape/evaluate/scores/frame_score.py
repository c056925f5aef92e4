"""A reconstructed frame against its truth: all metrics, region by region."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.rig import Rig
from beltscape.evaluate.scores.depth import GROSS_MM, DepthScore, interior_pixels, score_depth
from beltscape.evaluate.scores.reliability import false_fill, pixel_locking, sigma_ratios
from beltscape.evaluate.truth.simulated import WITHIN_MM, Truth
from beltscape.stereo.pairwise.reconstructor import horizontal_auxiliary

_LOCKED_LEAST = 10_000
"""Pixels from which pixel locking is more than noise."""


@dataclass(frozen=True, slots=True)
class RegionScore:
    """One region of a frame; NaN where there is nothing to count."""

    depth: DepthScore
    false_fill: float
    """Share of the region's pixels that no auxiliary sees which carry a depth."""
    sigma_ratio_low: float
    """Actual over predicted σ, least of fifths of ascending predicted σ."""
    sigma_ratio_high: float
    """Greatest of the fifths."""
    locking_px: float
    """Peak to peak of the mean error over the fraction of the disparity of the most horizontal auxiliary."""

    def document(self) -> Mapping[str, Any]:
        """Plain values for JSON."""
        own = asdict(self)
        return {**own.pop("depth"), **own}


def score_frame(
    depth: DepthMap, rig: Rig, truth: Truth, *, within_mm: float = WITHIN_MM
) -> Mapping[str, RegionScore]:
    """By region that the scene has, and of "all" of them: measured with a rig, held against the truth.

    The truth may be on another core's grid; regions end ``within_mm`` of the rig along the belt.
    """
    true = truth.on_grid_of(rig)
    return {
        name: _region(depth, rig, true, region)
        for name, region in true.regions(within_mm).items()
        if region.any()
    }


def _region(depth: DepthMap, rig: Rig, true: Truth, region: NDArray[np.bool_]) -> RegionScore:
    error = depth.depth_mm.astype(np.float64) - true.depth_mm
    inside = region & interior_pixels(true.depth_mm) & (np.abs(np.nan_to_num(error, nan=np.inf)) < GROSS_MM)
    ratios = sigma_ratios(error[inside], depth.sigma_mm[inside])
    return RegionScore(
        score_depth(depth, true.depth_mm, region),
        false_fill(depth, true.unseen & region),
        float(ratios.min()),
        float(ratios.max()),
        _locking(depth, rig, true, inside),
    )


def _locking(depth: DepthMap, rig: Rig, true: Truth, inside: NDArray[np.bool_]) -> float:
    if inside.sum() < _LOCKED_LEAST or not rig.auxiliaries:
        return np.nan
    name = horizontal_auxiliary(rig)
    rays = rig.core_camera.rays()[inside]
    measured, truth = (
        rig.cameras[name].project(rig.cam_from_core[name].apply(np.column_stack([rays * z[:, None], z])))[
            :, 0
        ]
        for z in (depth.depth_mm[inside].astype(np.float64), true.depth_mm[inside])
    )
    return pixel_locking(measured, truth)
