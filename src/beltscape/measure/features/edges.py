"""Edges of faces with their σ, and the dimensions that follow: length and width of a rectangle, diameter of a circle.

The offset of an edge follows from the likelihood of the image and from the depth map's rim: where its pixels leave
the face, to about a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.measure.features.edge_likelihood import (
    OFFSETS_PX,
    EdgeBand,
    FaceCoordinates,
    compute_edge_likelihood,
    compute_face_coordinates,
    make_round_band,
    make_straight_band,
)
from beltscape.measure.features.face import Face
from beltscape.measure.features.result import EdgeLine
from beltscape.measure.features.solids import NominalView

LOW_PX, OUTLINE_PX, CREASE_PX = 0.4, -0.1, 0.2
"""Bias of the rim beyond a low edge, the outline of something tall, and an edge with the solid's own side below it:
between ``standard`` (0.0, −0.2, 0.05) and ``fast`` (0.8, 0.1, 0.45) on simulated modules at 1224 and 612 px. The bias
depends on the surfaces: a base as dark as the belt has −1.0 px."""
RIM_SIGMA_PX = 0.9
"""Standard deviation of this bias over edges and presets (largest deviation: 1.75 px)."""
_TALL_MM = 20.0
"""Height of an edge over what lies beside it from which it is the outline of something tall."""
_ON_MM = 0.35
"""Pixels within this distance of the fitted face belong to it."""
_MIN_PIXELS = 30
"""Least number of pixels on either side of a rim."""
_SEARCH_PX = 8.0
"""Half of the range that is searched; the rim lies within the matcher's reach."""
_STEP_PX = 0.1
"""Step of the search; far below σ of the rim."""


def locate_rim_px(band: EdgeBand) -> float | None:
    """Return the offset that best separates pixels on the face from others, less the matcher's bias, or None."""
    across, off = band.across_px[band.clear], band.off_mm[band.clear]
    on = np.abs(off) < max(_ON_MM, 0.3 * band.px_mm)  # NaN is not on the face
    if min(on.sum(), (~on).sum()) < _MIN_PIXELS:
        return None
    inside, outside = np.sort(across[on]), np.sort(across[~on])
    tries = np.arange(-_SEARCH_PX, _SEARCH_PX + _STEP_PX / 2, _STEP_PX)
    misclassified = len(inside) - np.searchsorted(inside, tries) + np.searchsorted(outside, tries)
    best = np.nonzero(misclassified == misclassified.min())[0]
    if best[0] == 0 or best[-1] == len(tries) - 1:  # on one side only: no rim
        return None
    beyond = off[(across > 2) & (across < 6)]
    tall = bool(np.isfinite(beyond).any()) and float(np.nanmedian(beyond)) > _TALL_MM
    bias = OUTLINE_PX if tall and band.kind == "outline" else LOW_PX
    if band.kind == "crease":
        bias = CREASE_PX
    if band.kind == "round":
        bias = (OUTLINE_PX + CREASE_PX) / 2
    return float(tries[best].mean()) - bias


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


def locate_edge(
    band: EdgeBand, grey: NDArray[np.floating] | None, nuisances: NDArray[np.float64]
) -> Edge | None:
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
    band: EdgeBand,
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


_TILTS_PX = np.linspace(-0.6, 0.6, 7)[:, None]
"""Displacements of the end of a line that are tried."""
_SHIFTS_PX = np.stack(np.meshgrid(*[np.linspace(-0.6, 0.6, 7)] * 2), axis=-1).reshape(-1, 2)
"""Shifts of a circle that are tried, in columns and rows."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeScene:
    """The frame and the nominal module in which edges are located."""

    camera: Camera
    depth_mm: NDArray[np.float32]
    """(H, W)."""
    grey: NDArray[np.float32] | None
    """(H, W) brightness of the static scene in the core camera, on its undistorted grid."""
    view: NominalView
    core_from_module: Pose


@dataclass(frozen=True, slots=True)
class Extent:
    """A measured length across a face."""

    length_mm: float
    sigma_mm: float
    points: int


def measure_rectangle(
    scene: EdgeScene,
    name: str,
    label: int,
    face: Face,
    center: NDArray[np.float64],
    size_mm: tuple[float, float],
) -> tuple[tuple[Extent | None, Extent | None], list[EdgeLine]]:
    """Measure the extents in the module's x and y of a face centred at ``center`` (3,) mm; None without an edge."""
    half = size_mm[0] / 2, size_mm[1] / 2
    plane = _make_coordinates(scene, face, center, float(np.hypot(*half)))
    extents: list[Extent | None] = []
    lines: list[EdgeLine] = []
    for axis in (0, 1):
        pair: list[tuple[Edge, float]] = []
        for sign in (1, -1):
            band = make_straight_band(plane, scene.view, label, scene.depth_mm, half, axis, sign)
            edge = None if band is None else locate_edge(band, scene.grey, _TILTS_PX)
            if band is None or edge is None:
                continue
            pair.append((edge, band.px_mm))
            located, nominal = (
                _project_onto_face(scene, face, center, _compute_edge_ends(half, axis, sign, offset, tilt))
                for offset, tilt in ((edge.offset_px * band.px_mm, edge.nuisance[0] * band.px_mm), (0.0, 0.0))
            )
            lines.append(EdgeLine(name, located, nominal, edge.sigma_px * band.px_mm, edge.by_image))
        extents.append(_make_extent(size_mm[axis], pair) if len(pair) == 2 else None)
    return (extents[0], extents[1]), lines


def measure_circle(
    scene: EdgeScene, name: str, label: int, face: Face, center: NDArray[np.float64], diameter_mm: float
) -> tuple[Extent | None, list[EdgeLine]]:
    """Measure the diameter of a round face centred at ``center`` (3,) mm; None where its edge is not visible."""
    plane = _make_coordinates(scene, face, center, diameter_mm / 2)
    band = make_round_band(plane, scene.view, label, scene.depth_mm, diameter_mm / 2)
    edge = None if band is None else locate_edge(band, scene.grey, _SHIFTS_PX)
    if band is None or edge is None:
        return None, []
    angle = np.linspace(-np.pi, np.pi, 73)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    located = ring * (diameter_mm / 2 + edge.offset_px * band.px_mm) + edge.nuisance * band.px_mm
    measured, nominal = (
        _project_onto_face(scene, face, center, flat) for flat in (located, ring * diameter_mm / 2)
    )
    sigma = 2 * edge.sigma_px * band.px_mm
    extent = Extent(diameter_mm + 2 * edge.offset_px * band.px_mm, sigma, edge.points)
    return extent, [EdgeLine(name, measured, nominal, sigma / 2, edge.by_image)]


def _make_coordinates(
    scene: EdgeScene, face: Face, center: NDArray[np.float64], half_mm: float
) -> FaceCoordinates:
    pose = scene.core_from_module
    axes = pose.rotation[:, 0], pose.rotation[:, 1]
    return compute_face_coordinates(face, scene.camera, pose.apply(center), axes, half_mm)


def _make_extent(nominal_mm: float, pair: list[tuple[Edge, float]]) -> Extent:
    length = nominal_mm + sum(edge.offset_px * px for edge, px in pair)
    own = sum((edge.sigma_px**2 - edge.common_px**2) * px**2 for edge, px in pair)
    common = sum(edge.common_px * px for edge, px in pair)  # the rim's bias is the same on both sides
    sigma = float(np.sqrt(max(own, 0.0) + common**2))
    return Extent(length, sigma, sum(edge.points for edge, _ in pair))


def _compute_edge_ends(
    half: tuple[float, float], axis: int, sign: int, offset: float, tilt: float
) -> NDArray[np.float64]:
    """Return both ends (2, 2) of an edge on the face, mm, displaced outwards by ``offset`` -+ ``tilt``."""
    flat = np.empty((2, 2))
    flat[:, 1 - axis] = [-half[1 - axis], half[1 - axis]]
    flat[:, axis] = sign * (half[axis] + offset + tilt * np.array([-1.0, 1.0]))
    return flat


def _project_onto_face(
    scene: EdgeScene, face: Face, center: NDArray[np.float64], flat: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return points (n, 3) in the core's frame, on the face, of positions (n, 2) mm relative to ``center``."""
    points = scene.core_from_module.apply(np.column_stack([flat + center[:2], np.full(len(flat), center[2])]))
    off = (1 - points @ face.q) / float(np.linalg.norm(face.q))
    return points - off[:, None] * face.normal
