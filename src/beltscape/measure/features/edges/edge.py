"""The offset of an edge with its σ, from the likelihood of the image and the depth map's rim."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.measure.features.edges.band import Band
from beltscape.measure.features.edges.likelihood import OFFSETS_PX, compute_edge_likelihood
from beltscape.measure.features.edges.rim import RIM_SIGMA_PX, locate_rim_px

SYSTEMATIC_PX = 0.11
"""Systematic σ of an edge in one image, due to shading beside it and the shape of the blur (simulated modules)."""
_BLOCKS = 8
"""Blocks along an edge, which the jackknife leaves out one by one."""
_BEND = 3
"""Number of offset steps over which a curve's second difference is taken."""
_NUISANCE_PX = 0.3
"""Prior σ of the displacement of the edge's ends by a tilt or a shift."""
_NEAR_MM = 0.6
"""Prior σ of the distance of an edge from the nominal module's."""

_MAX_DEVIATION_SIGMA = 3.0
"""A rim farther than this many σ from the nominal edge belongs to something else."""


@dataclass(frozen=True, slots=True, eq=False)
class Edge:
    """The position of an edge relative to the nominal module's."""

    offset_px: float
    """Offset outwards."""
    sigma_px: float
    common_px: float
    """The part of σ that is common to all edges of a face, from the bias of the depth map's rim."""
    nuisance: NDArray[np.float64]
    """(J,) px, nuisance parameters of the band's shapes."""
    points: int
    """Number of pieces along the edge, or of the rim's pixels where no image was used."""
    by_image: bool


def locate_edge(band: Band, grey: NDArray[np.floating] | None, nuisances: NDArray[np.float64]) -> Edge | None:
    """Locate the edge in the image (H, W) with the depth map's rim as prior; by the rim alone without an image.

    The result is None where neither shows the edge. The most likely of ``nuisances`` (M, J) px is taken. The image's
    σ is a jackknife over blocks along the edge plus `SYSTEMATIC_PX`; where the rim contradicts the image, it is
    inflated until they agree.
    """
    rim, near = locate_rim_px(band), 1 / (_NEAR_MM / band.px_mm) ** 2
    if rim is not None and rim**2 > _MAX_DEVIATION_SIGMA**2 * (RIM_SIGMA_PX**2 + 1 / near):
        rim = None
    rim_weight = 0.0 if rim is None else 1 / RIM_SIGMA_PX**2
    start = (rim or 0.0) * rim_weight / (rim_weight + near)
    prior = (
        -0.5 * OFFSETS_PX**2 * (rim_weight + near)
        - 0.5 * np.sum((nuisances / _NUISANCE_PX) ** 2, axis=1)[:, None]
    )
    if grey is not None:
        here = grey.ravel()[band.index].astype(np.float64)
        edge = _locate_in_image(band, here, start, nuisances, prior)
        if edge is not None:
            return edge if rim is None else _inflate_for_conflict(edge, rim)
    if rim is None:
        return None
    return Edge(rim, RIM_SIGMA_PX, RIM_SIGMA_PX, np.zeros(int(band.shapes.shape[1])), len(band.index), False)


def _inflate_for_conflict(edge: Edge, rim: float) -> Edge:
    """Return the edge with σ times √χ², the scale factor of values that differ by more than their σ allow.

    Particle Data Group, Review of Particle Physics, introduction, section 5.2.2, doi:10.1103/PhysRevD.110.030001.
    """
    square = (edge.offset_px - rim) ** 2 / (edge.sigma_px**2 + RIM_SIGMA_PX**2)
    factor = float(np.sqrt(max(square, 1.0)))
    return replace(edge, sigma_px=edge.sigma_px * factor, common_px=edge.common_px * factor)


def _locate_in_image(
    band: Band,
    grey: NDArray[np.float64],
    start: float,
    nuisances: NDArray[np.float64],
    prior: NDArray[np.float64],
) -> Edge | None:
    likelihood = compute_edge_likelihood(band, grey, start, nuisances, prior, _BLOCKS)
    if likelihood is None:
        return None
    total = likelihood.blocks.sum(axis=0) + prior
    offset, nuisance = _find_peak(total)
    if abs(offset) > OFFSETS_PX[-2]:  # no maximum within the range
        return None
    taken = [k for k in range(_BLOCKS) if likelihood.blocks[k].any()]
    if len(taken) < 3:
        return None
    without = np.array([_find_peak(total - likelihood.blocks[k])[0] for k in taken])
    count = len(taken)
    spread = np.sqrt((count - 1) / count * np.sum((without - without.mean()) ** 2))
    prior_sigma = _compute_prior_sigma_px(likelihood.blocks.sum(axis=0)[nuisance], prior[nuisance])
    variance = max(spread**2 + prior_sigma**2, _compute_spread_px(total, offset) ** 2)
    sigma = float(np.sqrt(variance + SYSTEMATIC_PX**2))
    common = min(prior_sigma, sigma)
    return Edge(start + offset, sigma, common, nuisances[nuisance], likelihood.pieces, True)


def _compute_prior_sigma_px(likelihood: NDArray[np.float64], prior: NDArray[np.float64]) -> float:
    """Return the σ of an offset due to the prior, from the curvatures (O,) of likelihood and prior at the peak."""
    at = int(np.clip(np.argmax(likelihood + prior), _BEND, len(OFFSETS_PX) - 1 - _BEND))
    step = float(OFFSETS_PX[_BEND] - OFFSETS_PX[0])
    likelihood_curvature, prior_curvature = (
        max(float(2 * curve[at] - curve[at - _BEND] - curve[at + _BEND]) / step**2, 0.0)
        for curve in (likelihood, prior)
    )
    return (
        prior_curvature / (likelihood_curvature + prior_curvature) / float(np.sqrt(prior_curvature))
        if prior_curvature > 0
        else 0.0
    )


def _compute_spread_px(total: NDArray[np.float64], offset: float) -> float:
    """Return the posterior spread about an offset (px) over all nuisances (M, O), which includes a second peak."""
    likely = np.exp(total - total.max()).sum(axis=0)
    return float(np.sqrt(np.average((OFFSETS_PX - offset) ** 2, weights=likely)))


def _find_peak(total: NDArray[np.float64]) -> tuple[float, int]:
    """Return the interpolated offset (px) and the nuisance of the maximum of (M, O)."""
    nuisance, at = (int(n) for n in np.unravel_index(int(np.argmax(total)), total.shape))
    offset, step = float(OFFSETS_PX[at]), float(OFFSETS_PX[1] - OFFSETS_PX[0])
    if 0 < at < len(OFFSETS_PX) - 1:
        left, middle, right = total[nuisance, at - 1 : at + 2]
        bend = left - 2 * middle + right
        offset += 0.5 * step * float((left - right) / bend) if bend < 0 else 0.0
    return offset, nuisance
