"""Residuals of tie points under a rig: epipolar residuals and differences of disparity.

Their systematic part over an image is that of the medians of blocks, which neither noise nor false matches affect.
The reference is what a sound rig leaves in each block, as by its lens models.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Array
from beltscape.core.geometry.rig import Rig
from beltscape.core.statistics import MAD_TO_SIGMA, MEDIAN_TO_MEAN_SIGMA
from beltscape.stereo.consistency.tie_points import TiePoints


@dataclass(frozen=True, slots=True, eq=False)
class PairResiduals:
    """Residuals of one auxiliary against the core; NaN where a point was not found."""

    epipolar_px: Array
    """(N,) signed distance from the epipolar line in the undistorted auxiliary image."""
    inverse_depth: Array
    """(N,) 1/mm, triangulated: the point of the core's ray that is nearest to the auxiliary's."""
    sensitivity_px_mm: Array
    """(N,) displacement of the point along the epipolar line per 1/mm of inverse depth."""


def compute_pair_residuals(tie_points: TiePoints, rig: Rig, name: str) -> PairResiduals:
    """Return the residuals of the tie points in one auxiliary image."""
    core, camera, pose = rig.core_camera, rig.cameras[name], rig.cam_from_core[name]
    rays = np.concatenate(
        [(tie_points.core_px - core.center_px) / core.focal_px, np.ones((len(tie_points.core_px), 1))], axis=1
    )
    directions, shift = rays @ pose.rotation.T, pose.translation_mm
    observed = tie_points.undistort(name, camera)
    observed = np.concatenate([observed, np.ones((len(observed), 1))], axis=1)
    inverse_depth = _triangulate(observed, directions, shift)
    start = directions + tie_points.inverse_depth[:, None] * shift
    with np.errstate(invalid="ignore", divide="ignore"):
        # derivative of the pixel with respect to the inverse depth: the direction of the epipolar line
        along = (shift[:2] - start[:, :2] / start[:, 2:] * shift[2]) / start[:, 2:] * camera.focal_px
        length = np.linalg.norm(along, axis=1)
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / length[:, None]
        offset = (observed[:, :2] - start[:, :2] / start[:, 2:]) * camera.focal_px
        epipolar = (offset * normal).sum(axis=1)
    return PairResiduals(epipolar, inverse_depth, length)


def _triangulate(observed: Array, directions: Array, shift: Array) -> Array:
    """Return (N,) s with directions + s · shift nearest to the observed rays (least squares of the cross product)."""
    across = np.cross(observed, np.broadcast_to(shift, observed.shape))
    with np.errstate(invalid="ignore", divide="ignore"):
        return -(across * np.cross(observed, directions)).sum(axis=1) / (across * across).sum(axis=1)


def compute_disparity_residuals(one: PairResiduals, other: PairResiduals) -> Array:
    """Return the difference of two auxiliaries' inverse depths as disparity, (N,) px.

    Errors of one pixel in either image give it a standard deviation of 1.
    """
    a, b = one.sensitivity_px_mm, other.sensitivity_px_mm
    return (one.inverse_depth - other.inverse_depth) * a * b / np.hypot(a, b)


LEAST_POINTS = 12
"""Fewer residuals give no usable estimate."""
SCATTER_SHARE = 0.5
"""A systematic residual below this share of the scatter within blocks may come from the matches, such as patches of
natural texture whose depth is wrong."""
SIGNIFICANT_SIGMAS = 4.0
"""A systematic residual is significant from this number of its standard deviations on."""
_MATCHING_PX = 0.05
"""The matching itself causes residuals up to this; rendered captures under their true rigs have up to 0.03."""
BLOCKS = (4, 3)
"""Columns and rows of blocks over the image."""
LEAST_IN_BLOCK = 5
"""A block with fewer residuals is left out."""
_INLIER_PX = 3.0
"""An inlier is nearer than this to its block's median; false matches scatter over the search area."""


@dataclass(frozen=True, slots=True)
class SystematicResidual:
    """Common part of the residuals of an image."""

    rms_px: float
    """RMS of the block medians without the share of the noise; NaN: too few points."""
    sigma_px: float
    """One standard deviation of it."""
    median_px: float
    """Signed median of all residuals."""
    points: int
    inlier_share: float
    """Share of the residuals near their block's median; near that of all where no block has enough."""
    scatter_px: float
    """Median over the blocks of one standard deviation within a block."""

    @property
    def excess_px(self) -> float:
        """The part that neither noise nor matching explains, px; 0 where it was not measured."""
        least = np.hypot(_MATCHING_PX, SCATTER_SHARE * self.scatter_px)
        if not self.rms_px - SIGNIFICANT_SIGMAS * self.sigma_px > least:
            return 0.0
        return float(np.sqrt(self.rms_px**2 - least**2))


def find_blocks(pixels: Array, size_px: tuple[int, int]) -> NDArray[np.int64]:
    """Return (N,) the number of the block in which each pixel (N, 2) of an image lies."""
    column, row = (np.clip((pixels / size_px * BLOCKS).astype(np.int64), 0, np.array(BLOCKS) - 1)).T
    return column + BLOCKS[0] * row


def compute_block_medians(values: Array, blocks: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Return the median of the values (N,) in each block, 0 in an empty one, and their number; both (blocks,)."""
    counts = np.bincount(blocks, minlength=BLOCKS[0] * BLOCKS[1])
    if not len(values):
        return np.zeros(len(counts)), counts
    ordered, start = values[np.lexsort((values, blocks))], np.cumsum(counts) - counts
    low, high = (
        ordered[np.minimum(start + np.maximum(middle, 0), len(ordered) - 1)]
        for middle in ((counts - 1) // 2, counts // 2)
    )
    return np.where(counts > 0, (low + high) / 2, 0.0), counts


def estimate_systematic_residual(
    residual_px: Array, pixels: Array, size_px: tuple[int, int], pixel_scale: float = 1.0
) -> SystematicResidual:
    """Return the systematic part of residuals (N,), NaN where missing, at pixels (N, 2) of an image.

    ``pixel_scale`` is the pixel of the images in which the points were matched, in px of the rig's images.
    """
    good = np.isfinite(residual_px)
    count = int(good.sum())
    if count < LEAST_POINTS:
        return SystematicResidual(np.nan, np.nan, np.nan, count, np.nan, np.nan)
    values = residual_px[good]
    block_index = find_blocks(pixels[good], size_px)
    block_medians, counts = compute_block_medians(values, block_index)
    distance = np.abs(values - block_medians[block_index])
    used = counts >= LEAST_IN_BLOCK
    medians, weights = block_medians[used], counts[used]
    scatters = MAD_TO_SIGMA * compute_block_medians(distance, block_index)[0][used]
    if not used.any():  # too few in every block: inliers are near the median of all
        middle = float(np.median(values))
        near = float((np.abs(values - middle) < _INLIER_PX * pixel_scale).mean())
        return SystematicResidual(np.nan, np.nan, middle, count, near, np.nan)
    variances = MEDIAN_TO_MEAN_SIGMA**2 * scatters**2 / weights
    inliers = int((distance[used[block_index]] < _INLIER_PX * pixel_scale).sum())
    share = weights / weights.sum()
    noise = float(share @ variances)
    square = float(share @ np.square(medians))
    rms = float(np.sqrt(max(square - noise, 0.0)))
    sigma = np.sqrt(float(np.square(share) @ variances))
    return SystematicResidual(
        rms,
        float(sigma),
        float(np.median(values)),
        count,
        inliers / int(weights.sum()),
        float(np.median(scatters)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class ResidualReference:
    """Block medians of the residuals of a sound rig, px; 0 for a block or camera that was not measured."""

    size_px: tuple[int, int]
    """Size of the core's image."""
    epipolar_px: Mapping[str, Array]
    """By auxiliary: (blocks,) of its epipolar residuals."""
    disparity_px: Mapping[tuple[str, str], Array]
    """By two auxiliaries: (blocks,) of their disparity residuals."""

    def subtract_epipolar(self, residual_px: Array, pixels: Array, name: str) -> Array:
        """Return the epipolar residuals (N,) at the core's pixels (N, 2) without the reference."""
        return self._subtract(residual_px, pixels, self.epipolar_px.get(name))

    def subtract_disparity(self, residual_px: Array, pixels: Array, pair: tuple[str, str]) -> Array:
        """Return the disparity residuals (N,) at the core's pixels (N, 2) without the reference."""
        return self._subtract(residual_px, pixels, self.disparity_px.get(pair))

    def _subtract(self, residual_px: Array, pixels: Array, medians: Array | None) -> Array:
        return residual_px if medians is None else residual_px - medians[find_blocks(pixels, self.size_px)]


def compute_reference(tie_points: TiePoints, rig: Rig, names: tuple[str, ...]) -> ResidualReference:
    """Return the reference from the tie points of sound frames."""
    size_px, pixels = rig.core_camera.size_px, tie_points.core_px
    pairs = {name: compute_pair_residuals(tie_points, rig, name) for name in names}
    return ResidualReference(
        size_px,
        {name: _compute_medians(pairs[name].epipolar_px, pixels, size_px) for name in names},
        {
            (one, other): _compute_medians(
                compute_disparity_residuals(pairs[one], pairs[other]), pixels, size_px
            )
            for one, other in combinations(names, 2)
        },
    )


def _compute_medians(residual_px: Array, pixels: Array, size_px: tuple[int, int]) -> Array:
    """Return (blocks,) medians of the finite residuals."""
    good = np.isfinite(residual_px)
    medians, counts = compute_block_medians(residual_px[good], find_blocks(pixels[good], size_px))
    return np.where(counts >= LEAST_IN_BLOCK, medians, 0.0)
