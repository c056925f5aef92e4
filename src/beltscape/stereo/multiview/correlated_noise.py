"""Correlated noise: sigma of a surface where errors of the images are correlated between neighbouring pixels.

Least squares add up the information of neighbouring pixels as if their noise was independent. Noise that neighbours
share (after demosaicing, resampling, denoising, compression) averages out more slowly, and the surface's variance
is larger than stated. The disagreement of the views shows it: over a tile, every auxiliary by itself would shift
the surface by pull / information, and with independent noise these shifts differ with the variance 1 / information.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Floats
from beltscape.core.statistics import CHI2_MEDIAN
from beltscape.kernels import Kernels
from beltscape.kernels.planes import average_areas, average_blocks, find_plane_kernels, interpolate_plane
from beltscape.stereo.multiview.features import ConfidenceInputs
from beltscape.stereo.multiview.frame import PreparedFrame, Windows
from beltscape.stereo.multiview.surface import crop_projection

TILE_PX = 18
"""Side of a tile at scale 1: as much area as the last fit's Gaussian window of 5 px counts, √(4π) · 5."""
_BANDS, _TILE_ROWS = 4, 2
"""Bands of rows that are examined, and rows of tiles in each."""
_SMOOTH_TILES = 9
"""Width, in tiles, of the running mean that is subtracted: errors of the calibration are smooth."""
_SHARES = (0.05, 0.8)
"""Range of one view's share of the information in a tile that is used."""
_LEAST_INFORMATION = 0.05
"""Mean information of a tile's pixels, 1/px², below which it has no texture."""
_GROUPS = (0.0, 0.35, 0.7, 0.9, 1.0)
"""Quantiles of the information that bound the groups of tiles: bright material is less noisy than a dark belt."""
_LEAST_TILES = 60
"""Tiles below which a group has no estimate."""


Bands = tuple[tuple[int, int], ...]
"""The first row of each band, and that behind its last."""


@dataclass(frozen=True, slots=True, eq=False)
class Inflation:
    """Actual over stated variance of a surface as a function of the information of its pixels."""

    log_information: NDArray[np.float64]
    """(n,) ascending logarithms of the mean information per pixel, 1/px²; n is 0 where nothing could be estimated."""
    ratio: NDArray[np.float64]
    """(n,) variance of the views' disagreement over what independent noise makes."""
    overall: float
    """The same ratio for all of the image; NaN where nothing could be estimated."""


class _Regime(NamedTuple):
    """Parameters of the excess variance for one kind of noise; chosen on simulated captures with truth."""

    accounted: float
    """Inflation that sigma already accounts for."""
    gain: float
    """Excess of sigma's variance per excess of the inflation."""


_SMOOTHED = _Regime(1.8, 0.8)
"""White noise makes an inflation of 0.5 to 1.7: the core's noise is common to all views. Where neighbours share
noise after resampling, denoising or JPEG, the windows of the fit disagree as well, so sigma contains part of it."""
_DEMOSAICED = _Regime(1.0, 1.2)
"""Interpolation errors of demosaicing follow the texture, not the noise; gains from 0.7 to 2 were tried."""
_ALONE = 2.2
"""Inflation of demosaiced images with a single auxiliary: the median of frames with four."""


def inflate_sigma(sigma: Floats, inputs: ConfidenceInputs) -> Floats:
    """Return sigma (H, W), px, with the excess variance of correlated noise added to it.

    The excess is a multiple of the least squares' variance, or of sigma's square where that is less: the part of
    sigma that is not noise, at edges and on rough material, is not inflated. Without an excess sigma is unchanged.
    """
    prepared = inputs.prepared
    inflation = estimate_inflation(inputs.surface.s, inputs.depth_steps, prepared)
    excess, log_information = _compute_excess(inflation, demosaiced=prepared.noise.demosaiced)
    if not excess.any():
        return sigma
    side = compute_tile_side(prepared.context.scale)
    pixel_excess = _interpolate_by_information(
        excess, log_information, inputs.information, side, prepared.context.kernels
    )
    share = np.minimum(inputs.variance / np.square(sigma), 1)
    return (sigma * np.sqrt(1 + pixel_excess * share)).astype(np.float32, copy=False)


def _compute_excess(inflation: Inflation, *, demosaiced: bool) -> tuple[Floats, Floats]:
    """Return the excess (n,) of sigma's variance over that of least squares, and the log information (n,) it is for.

    Resampling and denoising correlate the noise of a whole image; no part of it has more excess than the whole.
    """
    ratio, log_information = inflation.ratio, inflation.log_information
    if not demosaiced:
        common = np.minimum(ratio, inflation.overall)
        return _SMOOTHED.gain * np.maximum(common - _SMOOTHED.accounted, 0), log_information
    if not len(ratio):
        ratio, log_information = np.full(1, _ALONE), np.zeros(1)
    return _DEMOSAICED.gain * np.maximum(ratio - _DEMOSAICED.accounted, 0), log_information


def _interpolate_by_information(
    values: Floats, log_information: Floats, information: Floats, side: int, kernels: Kernels
) -> NDArray[np.float32]:
    """Return (H, W) values that depend on the information (H, W) around a pixel, interpolated between tiles."""
    height, width = information.shape
    tiles = max(1, width // side), max(1, height // side)
    around = np.asarray(average_areas(information, tiles))
    tile_values = np.interp(np.log(np.maximum(around, 1e-9)), log_information, values).astype(np.float32)
    return interpolate_plane(kernels.keep(tile_values), (width, height))


def estimate_inflation(s: Floats, depth_steps: NDArray[np.bool_], prepared: PreparedFrame) -> Inflation:
    """Estimate the inflation from a few bands of rows of the final surface s (H, W), away from its depth steps.

    With a single auxiliary there is no disagreement; the estimate is empty.
    """
    height, windows = len(s), prepared.context.windows
    side = compute_tile_side(windows.scale)
    rows = min(height, _TILE_ROWS * side + 2 * windows.levels_px)
    firsts = np.linspace(0, height - rows, _BANDS + 2)[1:-1].astype(int)
    bands = tuple((int(first), int(first) + rows) for first in firsts)
    given = s, depth_steps, prepared, bands
    is_on_device = find_plane_kernels(s) and find_plane_kernels(depth_steps)
    tiles = _sum_on_device(*given) if is_on_device else _sum_on_processor(*given)
    parts = [_compute_squared_deviations(*sums, side) for sums in tiles]
    information, squares = (np.concatenate(values) for values in zip(*parts, strict=True))
    return _estimate_groups(np.log(information), squares)


def compute_tile_side(scale: float) -> int:
    """Return the side of a tile in px on a grid ``scale`` times finer than `TILE_PX` is for."""
    return max(3, round(TILE_PX * scale))


def _form_equations(s: Floats, prepared: PreparedFrame, bands: Bands) -> list[list[tuple[Floats, Floats]]]:
    """Return information and pull of each view by itself, in bands of rows (first, end) of the surface s (H, W)."""
    noise, context = prepared.noise, prepared.context

    def form(first: int, end: int, view: Floats, coefficients: Floats) -> tuple[Floats, Floats]:
        equations = context.kernels.normal_equations(
            s[first:end], prepared.core[first:end], [coefficients], crop_projection(view, 0, first)[None],
            window=context.windows.levels_px, floor=noise.floor, noise_variance=noise.levels,
            model_variance=noise.model, threads=context.threads,
        )  # fmt: skip
        return equations.information, equations.pull

    views = list(zip(prepared.views, prepared.coefficients, strict=True))
    return [[form(*band, *view) for view in views] for band in bands]


def _sum_on_processor(
    s: Floats, depth_steps: NDArray[np.bool_], prepared: PreparedFrame, bands: Bands
) -> list[tuple[Floats, Floats]]:
    """Return the sums of `_accumulate_tiles` for each band."""
    smooth, windows = ~np.asarray(depth_steps), prepared.context.windows
    equations = _form_equations(s, prepared, bands)
    return [
        _accumulate_tiles(of_band, smooth[first:end], windows)
        for of_band, (first, end) in zip(equations, bands, strict=True)
    ]


def _sum_on_device(
    s: Floats, depth_steps: NDArray[np.bool_], prepared: PreparedFrame, bands: Bands
) -> list[tuple[Floats, Floats]]:
    """Return what `_sum_on_processor` does, of planes on a GPU, from which only the sums are copied."""
    windows, views = prepared.context.windows, len(prepared.views)
    side, rows = compute_tile_side(windows.scale), bands[0][1] - bands[0][0] - 2 * windows.levels_px
    tiles = max(0, rows // side), s.shape[1] // side
    if 0 in tiles:
        nothing = np.zeros((views, *tiles))
        return [(nothing, nothing)] * len(bands)
    found = prepared.context.kernels.replay(_sum_all_tiles, s, depth_steps, prepared, bands)
    sums = np.asarray(found, np.float64).reshape(len(bands), views, 2, *tiles)
    return [(of_band[:, 0], of_band[:, 1]) for of_band in sums]


def _sum_all_tiles(
    s: Floats, depth_steps: NDArray[np.bool_], prepared: PreparedFrame, bands: Bands
) -> NDArray[np.float32]:
    """Return (bands · views · 2, tiles) the sums of information and pull on a GPU."""
    windows = prepared.context.windows
    side, levels_px = compute_tile_side(windows.scale), windows.levels_px
    planes: list[NDArray[np.float32]] = []
    for of_band, (first, end) in zip(_form_equations(s, prepared, bands), bands, strict=True):
        smooth, inner = ~depth_steps[first:end], slice(levels_px, end - first - levels_px)
        selected = (_select(plane, smooth)[inner] for of_view in of_band for plane in of_view)
        planes += [average_blocks(plane, side) * np.float32(side**2) for plane in selected]
    rows, columns = (axis.ravel() for axis in np.indices(planes[0].shape))
    return prepared.context.kernels.gather(planes, columns, rows, np.zeros((1, 2), int), threads=1)


def _accumulate_tiles(
    equations: Sequence[tuple[Floats, Floats]], smooth: NDArray[np.bool_], windows: Windows
) -> tuple[Floats, Floats]:
    """Sum information and pull of all views over the tiles of a band, each (views, tile rows, tile columns)."""
    side, inner = compute_tile_side(windows.scale), slice(windows.levels_px, len(smooth) - windows.levels_px)
    sums = [
        [_sum_tiles(_select(np.asarray(plane), smooth)[inner], side) for plane in of_view]
        for of_view in equations
    ]
    information, pull = (np.stack(values) for values in zip(*sums, strict=True))
    return information, pull


def _select(plane: Floats, mask: NDArray[np.bool_]) -> Floats:
    """Return the values inside the mask, and 0 outside it and in place of NaN."""
    return np.where(mask & ~np.isnan(plane), plane, np.float32(0))


def _sum_tiles(plane: Floats, side: int) -> NDArray[np.float64]:
    height, width = plane.shape[0] // side, plane.shape[1] // side
    blocks = plane[: height * side, : width * side].reshape(height, side, width, side)
    return blocks.sum(axis=(1, 3), dtype=np.float64)


def _compute_squared_deviations(information: Floats, pull: Floats, side: int) -> tuple[Floats, Floats]:
    """Return information per pixel (N,) of all views, and a view's squared shift over its expected variance (N,)."""
    whole = np.maximum(information.sum(axis=0), 1e-9)
    share = information / whole
    used = (share > _SHARES[0]) & (share < _SHARES[1]) & (whole > _LEAST_INFORMATION * side * side)
    apart = np.where(used, pull / np.maximum(information, 1e-9), 0) - pull.sum(axis=0) / whole
    weight = np.where(used, information / np.maximum(1 - share, 1e-9), 0)
    total, around = (_average_rows(plane) for plane in (weight * apart, weight))
    apart = apart - total / np.maximum(around, 1e-9)
    own = np.minimum(weight / np.maximum(_SMOOTH_TILES * around, 1e-9), 0.9)
    squares = apart**2 * weight / (1 - own)
    return np.broadcast_to(whole / side**2, used.shape)[used], squares[used]


def _average_rows(planes: Floats) -> Floats:
    """Average every plane (n, rows, columns) along its rows."""
    return np.stack([cv2.blur(p, (_SMOOTH_TILES, 1), borderType=cv2.BORDER_REPLICATE) for p in planes])


def _estimate_groups(log_information: Floats, squares: Floats) -> Inflation:
    """Take the robust mean of the squares in groups of similar information."""
    if len(squares) < _LEAST_TILES:
        return Inflation(np.empty(0), np.empty(0), np.nan)
    edges = np.quantile(log_information, _GROUPS)
    centres: list[float] = []
    ratios: list[float] = []
    for low, high in pairwise(edges):
        group = (log_information >= low) & (log_information <= high)
        if group.sum() >= _LEAST_TILES:
            centres.append(float(np.median(log_information[group])))
            ratios.append(float(np.median(squares[group])) / CHI2_MEDIAN)
    return Inflation(np.array(centres), np.array(ratios), float(np.median(squares)) / CHI2_MEDIAN)
