"""Scores of a reconstructed frame, or of all of a reconstruction, against the truth, by region.

Besides those of the depth they tell depth at occluded pixels, calibration of σ, and pixel locking.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.evaluate.depth_scores import (
    GROSS_MM,
    DepthScore,
    compute_robust_sigma,
    interior_mask,
    score_depth,
)
from beltscape.evaluate.truth import WITHIN_MM, Truth, TruthFile
from beltscape.files.reconstruction import find_rig_file, list_frame_folders, read_depth_map
from beltscape.files.rig_json import read_rig
from beltscape.stereo.pairwise.reconstructor import find_horizontal_auxiliary

SIGMA_BINS = 5
"""Number of groups of equal size by predicted σ."""
LOCKING_BINS = 10
"""Number of bins of the disparity's fraction, a tenth of a pixel each."""
_MATCHED_PX = 0.5
"""A larger error is a false match, not an interpolation error."""


def compute_false_fill(depth: DepthMap, occluded: NDArray[np.bool_]) -> float:
    """Return the share of the pixels (H, W) occluded in all auxiliaries that have a depth; NaN without any."""
    filled = np.isfinite(depth.depth_mm[occluded])
    return float(filled.mean()) if filled.size else np.nan


def compute_sigma_ratios(
    error_mm: NDArray[np.floating], sigma_mm: NDArray[np.floating], bins: int = SIGMA_BINS
) -> NDArray[np.float64]:
    """Return actual over predicted σ, (bins,), of equally large groups of ascending predicted σ.

    ``error_mm`` and ``sigma_mm`` are (N,); pixels without a finite σ are left out. NaN for an empty group.
    """
    known = np.isfinite(sigma_mm)
    error_mm, sigma_mm = error_mm[known], sigma_mm[known]
    groups = np.array_split(np.argsort(sigma_mm, kind="stable"), bins)
    return np.array([compute_robust_sigma(error_mm[group] / sigma_mm[group]) for group in groups])


def compute_pixel_locking(
    measured_px: NDArray[np.floating], true_px: NDArray[np.floating], bins: int = LOCKING_BINS
) -> float:
    """Return the peak-to-peak mean error, px, over the fraction of the true disparity; NaN for an empty bin.

    ``measured_px`` and ``true_px`` are (N,) disparities in px of the matched images. Errors above half a px are left
    out. Independent noise alone gives about 3 standard errors of a bin's mean.
    """
    error = measured_px - true_px
    good = np.abs(error) < _MATCHED_PX
    index = ((true_px[good] % 1.0) * bins).astype(np.intp) % bins
    count = np.bincount(index, minlength=bins)
    if not count.all():
        return np.nan
    return float(np.ptp(np.bincount(index, error[good], minlength=bins) / count))


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


def score_reconstruction(
    folder: Path, truth: TruthFile, reporter: Reporter, *, within_mm: float = WITHIN_MM
) -> Mapping[str, Mapping[str, RegionScore]]:
    """Return the scores by frame and region of a reconstruction ``DIR``, a frame folder in it, or one depth.tiff.

    Of a frame only depth.tiff is needed. Without rig.json beside it, it lies on the truth's own grid; without
    sigma.tiff, the scores of σ are NaN.

    Raises
    ------
    InputError
        When the folder contains no frame, or a frame has no truth.
    """
    frames = [folder] if folder.is_file() else list_frame_folders(folder)
    if not frames:
        raise InputError(
            f"{folder}: no frame with depth.tiff in it; give a folder of beltscape reconstruct or bs.write_depth"
        )
    scores: dict[str, Mapping[str, RegionScore]] = {}
    for number, frame in enumerate(frames):
        named = frame.resolve().parent.name if frame.is_file() else frame.resolve().name
        true = truth.for_frame(named)
        depth, rig = _read_frame(frame, true)
        scores[named] = score_frame(depth, rig, true, within_mm=within_mm)
        reporter.step("against the truth", number + 1, len(frames))
    return scores


def _read_frame(frame: Path, truth: Truth) -> tuple[DepthMap, Rig]:
    """Return a frame's depth map and the rig on whose core grid it lies; InputError where their sizes differ."""
    depth, path = read_depth_map(frame), find_rig_file(frame)
    rig = read_rig(path) if path.is_file() and truth.is_placed else truth.rig
    width, height = rig.core_camera.size_px
    if depth.depth_mm.shape != (height, width):
        own = f"{depth.depth_mm.shape[1]}×{depth.depth_mm.shape[0]}"
        of = path if rig is not truth.rig else "the truth"
        raise InputError(
            f"{frame}: {own} px, but the core camera of {of} has {width}×{height}; give depths on its "
            "undistorted grid, or the rig.json of another beside them"
        )
    return depth, rig
