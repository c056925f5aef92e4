"""Scores of a reconstructed frame against its truth, by region."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.rig import Rig
from beltscape.evaluate.scores.depth import GROSS_MM, DepthScore, interior_mask, score_depth
from beltscape.evaluate.scores.reliability import (
    compute_false_fill,
    compute_pixel_locking,
    compute_sigma_ratios,
)
from beltscape.evaluate.truth.simulated import WITHIN_MM, Truth
from beltscape.stereo.pairwise.reconstructor import find_horizontal_auxiliary

_LOCKED_LEAST = 10_000
"""Least number of pixels for pixel locking: with 1000 in a bin, noise of 0.1 px averages to 0.003."""


@dataclass(frozen=True, slots=True)
class RegionScore:
    """Scores of one region of a frame; NaN for an empty set of pixels."""

    depth: DepthScore
    false_fill: float
    """Share of the region's pixels occluded in all auxiliaries that nevertheless have a depth."""
    sigma_ratio_low: float
    """Actual over predicted σ, smallest over the quintiles of predicted σ."""
    sigma_ratio_high: float
    """Largest over the quintiles."""
    locking_px: float
    """Peak-to-peak mean error as a function of the disparity's fractional part, for the most horizontal auxiliary."""

    def document(self) -> Mapping[str, Any]:
        """Return the scores as plain values for JSON."""
        own = asdict(self)
        return {**own.pop("depth"), **own}


def score_frame(
    depth: DepthMap, rig: Rig, truth: Truth, *, within_mm: float = WITHIN_MM
) -> Mapping[str, RegionScore]:
    """Score a depth map against the truth in every region of the scene, and in "all" of them together.

    The truth may be on another core's grid; regions extend ``within_mm`` to each side of the rig along the belt.
    """
    true = truth if rig is truth.rig else truth.resample_to(rig)
    return {
        name: _region(depth, rig, true, region)
        for name, region in true.region_masks(within_mm).items()
        if region.any()
    }


def _region(depth: DepthMap, rig: Rig, true: Truth, region: NDArray[np.bool_]) -> RegionScore:
    error = depth.depth_mm.astype(np.float64) - true.depth_mm
    inside = region & interior_mask(true.depth_mm) & (np.abs(np.nan_to_num(error, nan=np.inf)) < GROSS_MM)
    ratios = compute_sigma_ratios(error[inside], depth.sigma_mm[inside])
    return RegionScore(
        score_depth(depth, true.depth_mm, region),
        compute_false_fill(depth, true.occluded & region),
        float(ratios.min()),
        float(ratios.max()),
        _locking(depth, rig, true, inside),
    )


def _locking(depth: DepthMap, rig: Rig, true: Truth, inside: NDArray[np.bool_]) -> float:
    if inside.sum() < _LOCKED_LEAST or not rig.auxiliaries:
        return np.nan
    name = find_horizontal_auxiliary(rig)
    rays = rig.core_camera.rays()[inside]
    measured, truth = (
        rig.cameras[name].project(rig.cam_from_core[name].apply(np.column_stack([rays * z[:, None], z])))[
            :, 0
        ]
        for z in (depth.depth_mm[inside].astype(np.float64), true.depth_mm[inside])
    )
    return compute_pixel_locking(measured, truth)
