"""The likelihood of an edge's offset given the image, summed over the pieces along the edge.

The band holds the pixels around one edge, in coordinates across and along it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from beltscape.core.geometry.camera import Camera
from beltscape.measure.features.face import Face, compute_rays
from beltscape.measure.features.smoothing import MATCHER_REACH_PX, compute_camera_scale
from beltscape.measure.features.solids import NO_PART, NominalView

WIDE_PX = 9.0
"""Half of a band's width."""
BIN_PX = 1.5
"""Length of the pieces along the edge that are evaluated one by one."""
_NEXT_PX = (1.0, 3.5)
"""Range outside the edge in which another part may occlude it; two parts in this range mean a second step."""
_MIXED_PX = 1.0
"""Pixels this near to another part are mixed."""
_NEARER_MM = 1.0
"""A part nearer to the camera by more than this occludes the edge."""
_SIDE_SHARE = 0.15
"""With a larger share of the solid's own side beyond an edge, the edge is a crease."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeBand:
    """Pixels around an edge, without those that occlude it or lie beyond a second step."""

    across_px: NDArray[np.float64]
    """(N,) distance from the nominal edge, outwards, in pixels on the face."""
    along_px: NDArray[np.float64]
    """(N,) position along the edge, from its middle."""
    bins: NDArray[np.intp]
    """(N,) number of the piece along the edge."""
    shapes: NDArray[np.float64]
    """(N, J) derivative of the edge's position across by the nuisance parameters (tilt; shifts of a circle)."""
    index: NDArray[np.intp]
    """(N,) index into the flattened image."""
    px_mm: float
    """Size of a pixel on the face."""
    off_mm: NDArray[np.float32]
    """(N,) measured depth minus the face's, NaN where not measured."""
    clear: NDArray[np.bool_]
    """(N,) whether no other part lies within the matcher's windows at its piece, so that its depth can be used."""
    kind: Literal["outline", "crease", "round"]
    """Crease: the solid's own side is visible beyond the edge; a round edge is partly outline, partly crease."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceCoordinates:
    """Coordinates in a face's plane of the pixels around it."""

    window: tuple[slice, slice]
    """Rows and columns."""
    x_mm: NDArray[np.float64]
    """(h, w) along the module's x, from the given centre."""
    y_mm: NDArray[np.float64]
    depth_mm: NDArray[np.float64]
    """(h, w) depth of the plane."""
    px_mm: float
    scale: float
    """See `compute_camera_scale`."""


def compute_face_coordinates(
    face: Face,
    camera: Camera,
    center_mm: NDArray[np.float64],
    axes: tuple[NDArray[np.float64], NDArray[np.float64]],
    half_mm: float,
) -> FaceCoordinates:
    """Return the coordinates in the face's plane around ``center_mm`` (3,), along projected ``axes`` (3,)."""
    normal = face.normal
    x_axis = axes[0] - (axes[0] @ normal) * normal
    x_axis /= np.linalg.norm(x_axis)
    y_axis = axes[1] - (axes[1] @ normal) * normal - (axes[1] @ x_axis) * x_axis
    y_axis /= np.linalg.norm(y_axis)
    height, _ = face.height_above(center_mm)
    center = center_mm - height * normal
    pixel = float(center[2] / camera.focal_px.mean())
    reach = half_mm / pixel + WIDE_PX + 2
    u, v = center[:2] / center[2] * camera.focal_px + camera.center_px
    width, tall = camera.size_px
    window = (
        slice(max(int(v - reach), 0), max(min(int(v + reach) + 1, tall), 0)),
        slice(max(int(u - reach), 0), max(min(int(u + reach) + 1, width), 0)),
    )
    rays = compute_rays(camera, *np.mgrid[window])
    depth = face.depth_at(rays)
    local = rays * depth[..., None] - center
    return FaceCoordinates(window, local @ x_axis, local @ y_axis, depth, pixel, compute_camera_scale(camera))


def make_straight_band(
    plane: FaceCoordinates,
    view: NominalView,
    label: int,
    depth_mm: NDArray[np.float32],
    half_mm: tuple[float, float],
    axis: int,
    sign: int,
) -> EdgeBand | None:
    """Return the band around the edge at ``sign · half_mm[axis]``; None where too little of it is visible."""
    coordinates = plane.x_mm, plane.y_mm
    across = (sign * coordinates[axis] - half_mm[axis]) / plane.px_mm
    along = coordinates[1 - axis] / plane.px_mm
    reach = half_mm[1 - axis] / plane.px_mm - 5
    near = (np.abs(across) < WIDE_PX) & (np.abs(along) < reach)
    return _select_pixels(
        plane, view, label, depth_mm, near, across, along, along[..., None] / max(reach, 1.0)
    )


def make_round_band(
    plane: FaceCoordinates, view: NominalView, label: int, depth_mm: NDArray[np.float32], radius_mm: float
) -> EdgeBand | None:
    """Return the band around a circle about the plane's origin; None where too little of it is visible."""
    far = np.hypot(plane.x_mm, plane.y_mm)
    across = (far - radius_mm) / plane.px_mm
    angle = np.arctan2(plane.y_mm, plane.x_mm)
    near = np.abs(across) < min(WIDE_PX, 0.7 * radius_mm / plane.px_mm)
    shapes = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return _select_pixels(plane, view, label, depth_mm, near, across, angle * radius_mm / plane.px_mm, shapes)


def _select_pixels(
    plane: FaceCoordinates,
    view: NominalView,
    label: int,
    depth_mm: NDArray[np.float32],
    near: NDArray[np.bool_],
    across: NDArray[np.float64],
    along: NDArray[np.float64],
    shapes: NDArray[np.float64],
) -> EdgeBand | None:
    if near.sum() < 60:
        return None
    window = plane.window
    labels, tops, nominal = view.label[window][near], view.top[window][near], view.depth_mm[window][near]
    across, along, shapes = across[near], along[near], shapes[near]
    bins = np.floor((along - along.min()) / BIN_PX).astype(np.intp)
    count = int(bins.max()) + 1
    over = nominal < plane.depth_mm[near] - _NEARER_MM
    last = _find_outermost(bins, across, count, ((labels != label) | ~tops) & (across < -1.0))
    next_part = -_find_outermost(bins, -across, count, over & (across > 1.0))
    occluded = (last > -_NEXT_PX[1]) | (next_part < _NEXT_PX[1])
    outside = (across > 0.15) & (across < _NEXT_PX[1]) & (labels != label)
    highest, lowest = np.full(count, NO_PART - 1), np.full(count, np.iinfo(np.int16).max)
    np.maximum.at(highest, bins[outside], labels[outside])
    np.minimum.at(lowest, bins[outside], labels[outside])
    occluded |= (highest > lowest) & (highest >= NO_PART)
    keep = ~occluded[bins] & (across > last[bins] + _MIXED_PX) & (across < next_part[bins] - _MIXED_PX)
    if keep.sum() < 60:
        return None
    rows, columns = np.mgrid[window]
    at = (rows * view.label.shape[1] + columns)[near][keep]
    off = (depth_mm.ravel()[at] - plane.depth_mm[near][keep]).astype(np.float32)
    beyond = keep & (across > 0.7) & (across < _NEXT_PX[1])
    crease = bool(beyond.any()) and float(np.mean(np.equal(labels[beyond], label))) > _SIDE_SHARE
    kind = "round" if shapes.shape[1] == 2 else "crease" if crease else "outline"
    reach = min(MATCHER_REACH_PX * plane.scale + 2, WIDE_PX)
    clear = ((last < -reach) & (next_part > reach))[bins[keep]]
    return EdgeBand(across[keep], along[keep], bins[keep], shapes[keep], at, plane.px_mm, off, clear, kind)


def _find_outermost(
    bins: NDArray[np.intp], across: NDArray[np.float64], count: int, other: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return the outermost position across (count,) of other parts, by piece; -inf where there are none."""
    furthest = np.full(count, -np.inf)
    np.maximum.at(furthest, bins[other], across[other])
    return furthest


BLUR_PX = 0.75
"""Gaussian blur of an edge: lens, pixel, and the undistortion's interpolation."""
OFFSETS_PX = np.arange(-2.5, 2.51, 0.1)
"""(O,) candidate offsets of the edge."""
_MARGIN_PX = 1.0
"""Additional range for the displacement of the edge along its length."""
_WINDOW_PX = 2.6
"""Half of the window in which a piece is evaluated; it moves with the offset, so that no offset is favoured."""
_STEP_WEIGHT, _QUANTILE_WEIGHT = 0.1, 0.1
"""Weights below 1, since neighbouring pieces share dots and both likelihoods use the same pixels."""
_SLOPE = 0.3
"""Prior σ of the brightness's slope per px beside the edge, as a share of its spread over its noise."""
_LEVELS = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Quantiles of the brightness that are compared between both sides."""
_CLEAR_PX = (1.3, 2.8)
"""Distance from the edge at which a side is neither blurred with the other nor another surface."""
_PIECE_PX = 60.0
"""Length of the stretches along the edge for which brightness quantiles are computed."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeLikelihood:
    """Log-likelihood by block along the edge, nuisance and offset."""

    blocks: NDArray[np.float64]
    """(K, M, O)."""
    pieces: int
    """Number of pieces along the edge that were evaluated."""


def compute_edge_likelihood(
    band: EdgeBand,
    grey: NDArray[np.float64],
    start_px: float,
    nuisances: NDArray[np.float64],
    prior: NDArray[np.float64],
    blocks: int,
) -> EdgeLikelihood | None:
    """Compute the likelihood of offsets ``start_px + OFFSETS_PX`` under each of the nuisances (M, J).

    It has two parts. Step: the gain of two lines that meet in a blurred step over a parabola, as models of the
    brightness across each short piece. Each piece has its own scale, so that dots and the dark between them both
    count. A single piece may step at a dot's rim; only at the edge do all pieces step together. Quantile: the
    distribution of brightness changes at the edge (composite quantile regression, Zou & Yuan, Ann. Statist. 36(3),
    2008, doi:10.1214/07-AOS507).

    ``grey`` (N,) is the brightness of the band's pixels, ``prior`` (M, O) the prior's log-density.
    """
    near = np.abs(band.across_px - start_px) < _WINDOW_PX - OFFSETS_PX[0] + _MARGIN_PX
    if not near.any():
        return None
    along = band.along_px[near]
    block = ((along - along.min()) / (np.ptp(along) + 1e-9) * blocks).astype(np.intp)
    noise = 0.003 * float(np.quantile(grey, 0.99)) + 1e-6
    pixels = _Pixels(
        band.across_px[near] - start_px, along, band.shapes[near], band.bins[near], grey[near],
        np.minimum(block, blocks - 1), blocks, noise,
    )  # fmt: skip
    total, pieces = _compute_step_likelihood(pixels, nuisances)
    if pieces < 8:
        return None
    total *= _STEP_WEIGHT
    if band.kind == "round":  # too short for an estimate of distributions
        return EdgeLikelihood(total, pieces)
    both = total
    for _ in range(3):
        at = float(OFFSETS_PX[int(np.argmax((both.sum(axis=0) + prior).max(axis=0)))])
        both = total + _QUANTILE_WEIGHT * _compute_quantile_likelihood(pixels, nuisances, at)
    return EdgeLikelihood(both, pieces)


@dataclass(frozen=True, slots=True, eq=False)
class _Pixels:
    """A band's pixels around the candidate offsets."""

    across: NDArray[np.float64]
    """(N,) px from the start offset."""
    along: NDArray[np.float64]
    shapes: NDArray[np.float64]
    """(N, J)."""
    bins: NDArray[np.intp]
    value: NDArray[np.float64]
    """(N,) brightness."""
    block: NDArray[np.intp]
    blocks: int
    noise: float
    """Noise of the brightness."""


def _compute_step_likelihood(
    pixels: _Pixels, nuisances: NDArray[np.float64]
) -> tuple[NDArray[np.float64], int]:
    """Return the gain in log-likelihood (K, M, O) by a step, summed over pieces, and the number of pieces."""
    order = np.argsort(pixels.bins, kind="stable")
    fine = np.arange(OFFSETS_PX[0] - _MARGIN_PX, OFFSETS_PX[-1] + _MARGIN_PX + 0.05, 0.1)
    total, pieces = np.zeros((pixels.blocks, len(nuisances), len(OFFSETS_PX))), 0
    for piece in np.split(order, np.nonzero(np.diff(pixels.bins[order]))[0] + 1):
        if len(piece) < 3 * _WINDOW_PX:
            continue
        gain = _compute_step_gain(pixels.across[piece], pixels.value[piece], fine, pixels.noise)
        displacement = nuisances @ pixels.shapes[piece].mean(axis=0)
        place = OFFSETS_PX[None] + np.clip(displacement, -_MARGIN_PX, _MARGIN_PX)[:, None]
        total[pixels.block[piece[0]]] += np.interp(place, fine, gain)
        pieces += 1
    return total, pieces


def _compute_step_gain(
    t: NDArray[np.float64], y: NDArray[np.float64], offsets: NDArray[np.float64], noise: float
) -> NDArray[np.float64]:
    """Return the gain (F,) in log-likelihood of a step at each offset over a parabola."""
    u = t[None] - offsets[:, None]
    weight = np.clip(1 - (u / _WINDOW_PX) ** 2, 0, None) ** 2
    count = weight.sum(axis=1)
    count_or_one = np.maximum(count, 1e-9)
    centred = y[None] - ((weight * y).sum(axis=1) / count_or_one)[:, None]
    square = (weight * centred**2).sum(axis=1)
    spread = np.sqrt(square / count_or_one) + noise
    z = u / BLUR_PX
    share, bell = ndtr(z), np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)
    step = np.stack(
        [1 - share, (z * (1 - share) - bell) * BLUR_PX, share, (z * share + bell) * BLUR_PX], axis=-1
    )
    ridge = np.diag([1e-6, 1 / _SLOPE**2, 1e-6, 1 / _SLOPE**2]) * (noise / spread)[:, None, None] ** 2
    smooth = np.stack([np.ones_like(u), u, u * u], axis=-1)
    left = [
        _sum_squared_residuals(design, weight, centred, square, more) / count_or_one + noise**2
        for design, more in ((smooth, 1e-6 * np.eye(3)), (step, ridge))
    ]
    both_sides = (weight * (u < 0)).sum(axis=1).clip(max=(weight * (u > 0)).sum(axis=1)) > 0.2 * count
    return np.where(both_sides, 0.5 * count * np.log(left[0] / left[1]), 0.0)


def _sum_squared_residuals(
    design: NDArray[np.float64],
    weight: NDArray[np.float64],
    value: NDArray[np.float64],
    square: NDArray[np.float64],
    ridge: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return weighted residual squares (F,) of ridge regressions: design (F, n, p), weight and value (F, n)."""
    normal = np.einsum("gni,gn,gnj->gij", design, weight, design) + ridge + 1e-9 * np.eye(design.shape[-1])
    right = np.einsum("gni,gn->gi", design, weight * value)
    answer = cast("NDArray[np.float64]", np.linalg.solve(normal, right[..., None]))[..., 0]
    return np.maximum(square - np.einsum("gi,gi->g", answer, right), 0)


def _compute_quantile_likelihood(
    pixels: _Pixels, nuisances: NDArray[np.float64], at: float
) -> NDArray[np.float64]:
    """Return minus the check loss (K, M, O) of brightness quantiles that change at the edge, over its minimum."""
    inner, outer = _compute_brightness_levels(pixels.across - at, pixels.along, pixels.value)
    mid = (np.abs(pixels.across - at) < _CLEAR_PX[0] + 0.7) & np.isfinite(inner[0])
    total = np.zeros((pixels.blocks, len(nuisances), len(OFFSETS_PX)))
    if mid.sum() < 40:
        return total
    t, y, edges = pixels.across[mid], pixels.value[mid], np.eye(pixels.blocks)[pixels.block[mid]]
    for level, a, b in zip(_LEVELS, inner[:, mid], outer[:, mid], strict=True):
        losses = np.empty_like(total)
        for m, nuisance in enumerate(nuisances):
            beyond: NDArray[np.float64] = (
                t[None] - pixels.shapes[mid] @ nuisance - OFFSETS_PX[:, None]
            ) / BLUR_PX
            share = ndtr(beyond)
            off: NDArray[np.float64] = y - (a + (b - a) * share)
            losses[:, m] = (np.maximum(off, 0) * level + np.maximum(-off, 0) * (1 - level)).dot(edges).T
        least = losses.sum(axis=0).min() / len(y) + 0.1 * pixels.noise
        total -= losses / least / len(_LEVELS)
    return total


def _compute_brightness_levels(
    across: NDArray[np.float64], along: NDArray[np.float64], value: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the quantiles (T, N) of the brightness inside and outside, by stretch; NaN where there are too few."""
    stretches = max(1, round(float(np.ptp(along)) / _PIECE_PX))
    stretch = np.minimum(
        ((along - along.min()) / (np.ptp(along) + 1e-9) * stretches).astype(int), stretches - 1
    )
    levels = np.full((2, len(_LEVELS), len(value)), np.nan)
    low, high = _CLEAR_PX
    for s in range(stretches):
        here = stretch == s
        sides = (across > -high) & (across < -low), (across > low) & (across < high)
        if min((here & side).sum() for side in sides) < 10:
            continue
        for into, side in zip(levels, sides, strict=True):
            into[:, here] = np.quantile(value[here & side], _LEVELS)[:, None]
    return levels[0], levels[1]
