"""An edge's offset with its σ: the image's evidence and the depth map's rim together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.measure.features.edges.band import Band
from beltscape.measure.features.edges.rim import RIM_SIGMA_PX, rim_px
from beltscape.measure.features.edges.votes import OFFSETS_PX, evidence

SYSTEMATIC_PX = 0.11
"""Of an edge in one image: how shading beside it and the shape of the blur move it (simulated modules)."""
_BLOCKS = 8
_BEND = 3
"""Steps of the offsets over which a curve's bend is taken."""
_NUISANCE_PX = 0.3
"""How far a tilt or a shift is expected to move the edge's ends."""
_NEAR_MM = 0.6
"""An edge is looked for about so far from where the perfect module has it; a sharp one is found farther off."""

_AGREE = 3.0
"""A rim more than so many σ from there is another thing's."""


@dataclass(frozen=True, slots=True, eq=False)
class Edge:
    """Where an edge is, against where the perfect module has it."""

    offset_px: float
    """Outwards."""
    sigma_px: float
    common_px: float
    """The part of σ that is common to all edges of a face: what it owes to the rim's reach."""
    nuisance: NDArray[np.float64]
    """(J,) px, of the band's shapes."""
    points: int
    """Pieces (pixels of the rim where no image was used) that voted."""
    by_image: bool


def locate(band: Band, grey: NDArray[np.floating] | None, nuisances: NDArray[np.float64]) -> Edge | None:
    """The edge by the image (H, W) on what depth expects; by depth alone without one; None where neither shows it.

    Of ``nuisances`` (M, J) px of the band's shapes the likeliest is taken. The image's σ is a jackknife over blocks
    along the edge, with `SYSTEMATIC_PX` on top; where the rim of the depth
    contradicts the image, it grows until they agree.
    """
    rim, near = rim_px(band), 1 / (_NEAR_MM / band.px_mm) ** 2
    if rim is not None and rim**2 > _AGREE**2 * (RIM_SIGMA_PX**2 + 1 / near):
        rim = None
    told = 0.0 if rim is None else 1 / RIM_SIGMA_PX**2
    start = (rim or 0.0) * told / (told + near)
    prior = (
        -0.5 * OFFSETS_PX**2 * (told + near) - 0.5 * np.sum((nuisances / _NUISANCE_PX) ** 2, axis=1)[:, None]
    )
    if grey is not None:
        here = grey.ravel()[band.index].astype(np.float64)
        edge = _by_image(band, here, start, nuisances, prior)
        if edge is not None:
            return edge if rim is None else _with_conflict(edge, rim)
    if rim is None:
        return None
    return Edge(rim, RIM_SIGMA_PX, RIM_SIGMA_PX, np.zeros(band.shapes.shape[1]), len(band.index), False)


def _with_conflict(edge: Edge, rim: float) -> Edge:
    """Return the edge with σ times √χ², the scale factor of values that differ by more than their σ allow.

    Particle Data Group, Review of Particle Physics, introduction, section 5.2.2, doi:10.1103/PhysRevD.110.030001.
    """
    square = (edge.offset_px - rim) ** 2 / (edge.sigma_px**2 + RIM_SIGMA_PX**2)
    factor = float(np.sqrt(max(square, 1.0)))
    return replace(edge, sigma_px=edge.sigma_px * factor, common_px=edge.common_px * factor)


def _by_image(
    band: Band,
    grey: NDArray[np.float64],
    start: float,
    nuisances: NDArray[np.float64],
    prior: NDArray[np.float64],
) -> Edge | None:
    told = evidence(band, grey, start, nuisances, prior, _BLOCKS)
    if told is None:
        return None
    total = told.blocks.sum(axis=0) + prior
    offset, nuisance = _peak(total)
    if abs(offset) > OFFSETS_PX[-2]:  # it only grows towards something else
        return None
    taken = [k for k in range(_BLOCKS) if told.blocks[k].any()]
    if len(taken) < 3:
        return None
    without = np.array([_peak(total - told.blocks[k])[0] for k in taken])
    count = len(taken)
    spread = np.sqrt((count - 1) / count * np.sum((without - without.mean()) ** 2))
    leaning = _leaning_px(told.blocks.sum(axis=0)[nuisance], prior[nuisance])
    unsure = max(spread**2 + leaning**2, _width_px(total, offset) ** 2)
    sigma = float(np.sqrt(unsure + SYSTEMATIC_PX**2))
    common = min(leaning, sigma)
    return Edge(start + offset, sigma, common, nuisances[nuisance], told.pieces, True)


def _leaning_px(evidence: NDArray[np.float64], prior: NDArray[np.float64]) -> float:
    """How uncertain an offset is because it leans on what was known before: (O,) both, by their bends at the peak."""
    at = int(np.clip(np.argmax(evidence + prior), _BEND, len(OFFSETS_PX) - 1 - _BEND))
    step = float(OFFSETS_PX[_BEND] - OFFSETS_PX[0])
    shown, known = (
        max(float(2 * curve[at] - curve[at - _BEND] - curve[at + _BEND]) / step**2, 0.0)
        for curve in (evidence, prior)
    )
    return known / (shown + known) / float(np.sqrt(known)) if known > 0 else 0.0


def _width_px(total: NDArray[np.float64], offset: float) -> float:
    """Spread about an offset (px) of what is as likely, all nuisances together: a second peak counts. (M, O)."""
    likely = np.exp(total - total.max()).sum(axis=0)
    return float(np.sqrt(np.average((OFFSETS_PX - offset) ** 2, weights=likely)))


def _peak(total: NDArray[np.float64]) -> tuple[float, int]:
    """Offset (px, between the tries) and nuisance of the highest point of (M, O)."""
    nuisance, at = (int(n) for n in np.unravel_index(int(np.argmax(total)), total.shape))
    offset, step = float(OFFSETS_PX[at]), float(OFFSETS_PX[1] - OFFSETS_PX[0])
    if 0 < at < len(OFFSETS_PX) - 1:
        left, middle, right = total[nuisance, at - 1 : at + 2]
        bend = left - 2 * middle + right
        offset += 0.5 * step * float((left - right) / bend) if bend < 0 else 0.0
    return offset, nuisance
