"""Scores of depth maps and of rigs against the truth.

A depth map's are coverage, accuracy and the reliability of its σ; a rig's are pose errors, and depth errors in the
working volume.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.geometry.rig import Rig
from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.kernels import Kernels

INTERIOR_PX = 6
"""A pixel is interior when it is farther than this from a step of the true depth: beyond the windows of matching."""
GROSS_MM = 5.0
"""A larger error is a false surface, not noise, which is tenths of a millimetre."""
_STEP = 0.003
"""Second difference of the true depth, over its median, at a step: 2 mm at 0.7 m, some three pixels' footprint."""


@dataclass(frozen=True, slots=True)
class DepthScore:
    """Scores of a depth map against the truth on the same grid; NaN for an empty set of pixels."""

    pixels: int
    """Pixels of the region that have a true depth."""
    coverage: float
    """Share of them that was measured, 0..1."""
    within_1mm: float
    """Share of ALL of them with |dz| < 1 mm; an unmeasured pixel counts as wrong."""
    within_quarter_mm: float
    """Share of ALL of them with |dz| < 0.25 mm."""
    gross: float
    """Share of the measured pixels with |dz| > 5 mm."""
    interior_median_mm: float
    """Median |dz| of measured pixels farther than 6 px from a true depth step."""
    interior_bias_mm: float
    """Median dz there, measured minus true."""
    interior_robust_sigma_mm: float
    """1.4826·MAD of dz there."""
    interior_p95_mm: float
    """95th percentile of |dz| there."""
    interior_gross: float
    """Share of the measured interior pixels with |dz| > 5 mm."""
    sigma_ratio: float
    """Actual over predicted sigma there: 1.4826·MAD of dz/sigma."""


def score_depth(
    depth: DepthMap,
    true_depth_mm: NDArray[np.floating],
    region: NDArray[np.bool_] | None = None,
    *,
    step_mm: float | None = None,
) -> DepthScore:
    """Compare a depth map with the truth.

    Parameters
    ----------
    depth
        The measured depth map.
    true_depth_mm
        (H, W) true depth on the same grid, mm; NaN: none.
    region
        (H, W) bool: pixels to compare; all by default.
    step_mm
        Threshold of a step of the true depth; see `interior_mask`.

    Raises
    ------
    InputError
        When the shapes differ.
    """
    if true_depth_mm.shape != depth.depth_mm.shape:
        raise InputError(f"the truth is {true_depth_mm.shape}, the depth map {depth.depth_mm.shape} pixels")
    truth = np.asarray(true_depth_mm, np.float64)
    valid = np.isfinite(truth) if region is None else np.isfinite(truth) & region
    error = depth.depth_mm.astype(np.float64) - truth
    measured = valid & np.isfinite(error)
    inside = measured & interior_mask(truth, step_mm=step_mm)
    count = int(valid.sum())
    size = np.abs(error[measured])
    dz = error[inside]
    return DepthScore(
        pixels=count,
        coverage=_share(measured.sum(), count),
        within_1mm=_share((size < 1.0).sum(), count),
        within_quarter_mm=_share((size < 0.25).sum(), count),
        gross=_share((size > GROSS_MM).sum(), size.size),
        interior_median_mm=_median(np.abs(dz)),
        interior_bias_mm=_median(dz),
        interior_robust_sigma_mm=compute_robust_sigma(dz),
        interior_p95_mm=float(np.percentile(np.abs(dz), 95)) if dz.size else np.nan,
        interior_gross=_share((np.abs(dz) > GROSS_MM).sum(), dz.size),
        sigma_ratio=_compute_sigma_ratio(dz, depth.sigma_mm[inside]),
    )


def _compute_sigma_ratio(error_mm: NDArray[np.float64], sigma_mm: NDArray[np.float32]) -> float:
    """Return actual over predicted σ, of the pixels that have a σ."""
    known = np.isfinite(sigma_mm)
    return compute_robust_sigma(error_mm[known] / sigma_mm[known])


def interior_mask(
    true_depth_mm: NDArray[np.floating], *, distance_px: float = INTERIOR_PX, step_mm: float | None = None
) -> NDArray[np.bool_]:
    """Return the mask (H, W) of pixels farther than ``distance_px`` from a step of the true depth or its boundary.

    At a step the second difference of the depth exceeds ``step_mm``; a slope, however steep, is no step.
    By default 0.003 of the median depth: 2 mm at 0.7 m, some three pixels' footprint.
    """
    truth = np.asarray(true_depth_mm, np.float64)
    step = ~np.isfinite(truth)
    if step.all():
        return ~step
    limit = _STEP * float(np.nanmedian(truth)) if step_mm is None else step_mm
    for axis in (0, 1):
        bend = np.abs(np.diff(truth, n=2, axis=axis))
        core = [slice(None), slice(None)]
        core[axis] = slice(1, -1)
        step[tuple(core)] |= bend > limit
    if not step.any():
        return ~step
    return np.asarray(ndimage.distance_transform_edt(~step)) > distance_px


def compute_robust_sigma(values: NDArray[np.floating]) -> float:
    """Return 1.4826 times the median absolute deviation from the median, a robust standard deviation."""
    return MAD_TO_SIGMA * _median(np.abs(values - np.median(values))) if values.size else np.nan


def _median(values: NDArray[np.floating]) -> float:
    return float(np.median(values)) if values.size else np.nan


def _share(part: int | np.integer, whole: int) -> float:
    return float(part) / whole if whole else np.nan


WORKING_VOLUME_MM = ((-300.0, 300.0), (-240.0, 240.0), (600.0, 760.0))
"""Range of x, y, z in the core camera's frame: the belt, its load and its edges in the rendered captures."""


@dataclass(frozen=True, slots=True)
class RigScore:
    """Differences of a rig from the true one."""

    depth_rms_mm: float
    """Error of points projected with the true rig and triangulated with the tested one."""
    depth_max_mm: float
    rotation_deg: Mapping[str, float]
    """Angle between true and tested pose of each camera, about the core."""
    center_mm: Mapping[str, float]
    """Distance of each camera's centre from the true one, in the core's frame."""


def score_rig_against_truth(rig: Rig, truth: Rig, kernels: Kernels) -> RigScore:
    """Project a grid of points in the working volume with the true rig and triangulate them with the tested one."""
    axes = [np.linspace(low, high, 9) for low, high in WORKING_VOLUME_MM]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    names = [name for name in truth.cameras if name in rig.cameras]
    pixels = np.stack([truth.project_into(rig, name, points) for name in names])
    measured = kernels.triangulate(np.stack([rig.projection(name) for name in names]), pixels)
    error = measured[:, 2] - points[:, 2]
    error = error[np.isfinite(error)]
    differences = {name: rig.cam_from_core[name] @ truth.cam_from_core[name].inverse() for name in names}
    centers = {
        name: rig.cam_from_core[name].center_mm - truth.cam_from_core[name].center_mm for name in names
    }
    return RigScore(
        depth_rms_mm=float(np.sqrt((error**2).mean())) if error.size else float("nan"),
        depth_max_mm=float(np.abs(error).max()) if error.size else float("nan"),
        rotation_deg={name: pose.angle_deg for name, pose in differences.items()},
        center_mm={name: float(np.linalg.norm(offset)) for name, offset in centers.items()},
    )
