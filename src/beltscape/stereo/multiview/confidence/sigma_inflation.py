"""Inflation of a surface's variance by image errors that are correlated between neighbouring pixels.

Least squares add up the information of neighbouring pixels as if their noise was independent. Noise that neighbours
share (after demosaicing, resampling, denoising, compression) averages out more slowly, and the surface's variance
is larger than stated. The disagreement of the views shows it: over a tile, every auxiliary by itself would shift
the surface by pull / information, and with independent noise these shifts differ with the variance 1 / information.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.statistics import CHI2_MEDIAN
from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.inverse_depth import crop_projection
from beltscape.stereo.multiview.frame.nan import fill_nan
from beltscape.stereo.multiview.frame.surface import Surface, detect_depth_steps

Array = NDArray[np.floating]

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


@dataclass(frozen=True, slots=True, eq=False)
class Inflation:
    """Actual over stated variance of a surface as a function of the information of its pixels."""

    log_information: NDArray[np.float64]
    """(n,) ascending logarithms of the mean information per pixel, 1/px²; n is 0 where nothing could be estimated."""
    ratio: NDArray[np.float64]
    """(n,) variance of the views' disagreement over what independent noise makes."""
    overall: float
    """The same ratio for all of the image; NaN where nothing could be estimated."""


def estimate_inflation(surface: Surface, prepared: PreparedFrame) -> Inflation:
    """Estimate the inflation from a few bands of rows of a final surface.

    With a single auxiliary there is no disagreement; the estimate is empty.
    """
    height, windows = len(surface.s), prepared.context.windows
    side = compute_tile_side(windows.scale)
    rows = min(height, _TILE_ROWS * side + 2 * windows.levels_px)
    firsts = np.linspace(0, height - rows, _BANDS + 2)[1:-1].astype(int)
    tiles = [_accumulate_tiles(surface.s, prepared, slice(f, f + rows)) for f in firsts]
    parts = [_compute_squared_deviations(*sums, side) for sums in tiles]
    information, squares = (np.concatenate(values) for values in zip(*parts, strict=True))
    return _estimate_groups(np.log(information), squares)


def compute_tile_side(scale: float) -> int:
    """Return the side of a tile in px on a grid ``scale`` times finer than `TILE_PX` is for."""
    return max(3, round(TILE_PX * scale))


def _accumulate_tiles(s: Array, prepared: PreparedFrame, rows: slice) -> tuple[Array, Array]:
    """Sum information and pull over the tiles of a band, each (views, tile rows, tile columns)."""
    band, noise, context = np.ascontiguousarray(s[rows]), prepared.noise, prepared.context
    levels_px, side = context.windows.levels_px, compute_tile_side(context.scale)
    core = np.ascontiguousarray(prepared.core[rows])
    smooth = ~detect_depth_steps(fill_nan(band))
    sums: list[list[Array]] = []
    for view, coefficients in zip(prepared.views, prepared.coefficients, strict=True):
        equations = context.kernels.normal_equations(
            band, core, [coefficients], crop_projection(view, 0, rows.start)[None], window=levels_px,
            floor=noise.floor, noise_variance=noise.levels, model_variance=noise.model, threads=context.threads,
        )  # fmt: skip
        inner = slice(levels_px, len(band) - levels_px)
        planes = (fill_nan(equations.information) * smooth, fill_nan(equations.pull) * smooth)
        sums.append([_sum_tiles(plane[inner], side) for plane in planes])
    information, pull = (np.stack(values) for values in zip(*sums, strict=True))
    return information, pull


def _sum_tiles(plane: Array, side: int) -> NDArray[np.float64]:
    height, width = plane.shape[0] // side, plane.shape[1] // side
    blocks = plane[: height * side, : width * side].reshape(height, side, width, side)
    return blocks.sum(axis=(1, 3), dtype=np.float64)


def _compute_squared_deviations(information: Array, pull: Array, side: int) -> tuple[Array, Array]:
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


def _average_rows(planes: Array) -> Array:
    """Average every plane (n, rows, columns) along its rows."""
    return np.stack([cv2.blur(p, (_SMOOTH_TILES, 1), borderType=cv2.BORDER_REPLICATE) for p in planes])


def _estimate_groups(log_information: Array, squares: Array) -> Inflation:
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
