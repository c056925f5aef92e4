"""The references of the kernels of geometry: triangulation, visibility, heights, and the march of rays.

Points from rays; visibility of the core's surface from an auxiliary; orthographic projection of a depth map's
triangles; ray march step by step.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.geometry import (
    EDGE,
    LEAST_FREEDOM,
    LEAST_LAYER_SIGMA,
    BuffersInput,
    LayersInput,
    RasterisationInput,
    TriangulationInput,
    VisibleInput,
)
from beltscape.kernels.reference.view import project

MAX_CONDITION = 1e12
"""A point is refused when ‖N‖·‖N⁻¹‖ (Frobenius) of its normal matrix exceeds this, because then four digits of a
double are left."""


def triangulate(given: TriangulationInput) -> tuple[NDArray[np.float64]]:
    """Return the points (N, 3)."""
    projections, pixels = given
    points = [_triangulate_point(projections, p) for p in np.swapaxes(pixels, 0, 1)]
    return (np.array(points).reshape(-1, 3),)


def _triangulate_point(projections: NDArray[np.float64], pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return one point (3,) from projections (n, 3, 4) and pixels (n, 2): Eq. 3 solved by least squares."""
    seen = np.isfinite(pixels).all(axis=1)
    if seen.sum() < 2:
        return np.full(3, np.nan)
    m, (u, v) = projections[seen], pixels[seen].T
    rows_u = u[:, None] * m[:, 2, :] - m[:, 0, :]
    rows_v = v[:, None] * m[:, 2, :] - m[:, 1, :]
    equations = np.concatenate([rows_u, rows_v])
    a, b = equations[:, :3], -equations[:, 3]
    singular = np.linalg.svd(a, compute_uv=False)
    squared = singular**2
    with np.errstate(divide="ignore"):
        condition = np.linalg.norm(squared) * np.linalg.norm(1 / squared)
    if not condition < MAX_CONDITION:
        return np.full(3, np.nan)
    return np.linalg.lstsq(a, b, rcond=None)[0]


def inverse_depth_buffers(given: BuffersInput, sizes: Sequence[tuple[int, int]]) -> list[NDArray[np.float64]]:
    """Return n buffers of the (width, height) of ``sizes``."""
    return [_buffer(given.s, view, size) for view, size in zip(given.views, sizes, strict=True)]


def _buffer(
    s: NDArray[np.floating], view: NDArray[np.floating], size: tuple[int, int]
) -> NDArray[np.float64]:
    width, height = size
    y, x = cast("NDArray[np.int64]", np.indices(s.shape))
    u, v, inverse_depth = project(view, x, y, s.astype(np.float64))
    u, v, inverse_depth = (a[np.isfinite(u)] for a in (u, v, inverse_depth))
    framed = np.zeros((height + 2, width + 2))  # a pixel all around, for what is seen half outside
    near = (u >= -1) & (u < width) & (v >= -1) & (v < height)
    column, row = np.floor(u[near]).astype(int) + 1, np.floor(v[near]).astype(int) + 1
    for right in (0, 1):
        for down in (0, 1):
            np.maximum.at(framed, (row + down, column + right), inverse_depth[near])
    return framed[1:-1, 1:-1].copy()


def visible(given: VisibleInput) -> tuple[NDArray[np.uint8]]:
    """Return (H, W) 1 where a pixel is seen."""
    s, view, buffer, tolerance = given
    y, x = cast("NDArray[np.int64]", np.indices(s.shape))
    u, v, inverse_depth = project(view, x, y, s.astype(np.float64))
    column, row = np.floor(u + 0.5), np.floor(v + 0.5)
    inside = (column >= 0) & (column < buffer.shape[1]) & (row >= 0) & (row < buffer.shape[0])
    out = np.zeros(s.shape, np.uint8)
    nearest = buffer[row[inside].astype(int), column[inside].astype(int)]
    out[inside] = nearest <= inverse_depth[inside] + tolerance
    return (out,)


def rasterise_heights(
    given: RasterisationInput, shape: tuple[int, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return height and variance of the grid's ``shape``."""
    depth, sigma, use, matrix, step = given
    with np.errstate(all="ignore"):
        variance = sigma.astype(np.float64) ** 2
        points = np.stack([*_points(depth, matrix), variance], axis=-1)
        corners = _triangles(depth, use & np.isfinite(points).all(axis=-1), np.float32(step))
        return _uppermost(points.reshape(-1, 4), corners, shape)


def _points(depth: NDArray[np.float32], matrix: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    """Yield column, row and height of every pixel, each (H, W)."""
    v, u = np.indices(depth.shape, dtype=np.float64)
    for across, down, ahead, shift in matrix:
        yield (across * u + (down * v + ahead)) * depth + shift


def _triangles(depth: NDArray[np.float32], use: NDArray[np.bool_], step: np.float32) -> NDArray[np.int64]:
    """Return (M, 3) flat pixel indices of the triangles' corners."""
    index = np.arange(use.size).reshape(use.shape)

    def joined(one: tuple[slice, slice], two: tuple[slice, slice]) -> NDArray[np.bool_]:
        return use[one] & use[two] & (np.abs(depth[one] - depth[two]) <= step)

    front, back, whole = slice(None, -1), slice(1, None), slice(None)
    across, down = joined((whole, front), (whole, back)), joined((front, whole), (back, whole))
    rising, falling = joined((front, back), (back, front)), joined((front, front), (back, back))
    falling &= ~rising
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    kinds = (
        (across[:-1] & down[:, :-1] & rising, (a, b, c)),
        (across[1:] & down[:, 1:] & rising, (b, d, c)),
        (across[:-1] & down[:, 1:] & falling, (a, b, d)),
        (across[1:] & down[:, :-1] & falling, (a, d, c)),
    )
    return np.concatenate([np.stack([corner[on] for corner in corners], axis=1) for on, corners in kinds])


def _uppermost(
    points: NDArray[np.float64], corners: NDArray[np.int64], shape: tuple[int, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the highest height and its variance over each node, of triangles ``corners`` (M, 3).

    ``points`` (N, 4) are column, row, height and variance.
    """
    height, variance = np.full(shape, -np.inf), np.full(shape, -np.inf)
    hits = list(_hits(points, corners, shape))
    for node, here, _ in hits:
        np.maximum.at(height, node, here)
    for node, here, other in hits:
        top = here == height[node]
        np.maximum.at(variance, (node[0][top], node[1][top]), other[top])
    there = height > -np.inf
    height += 0.0  # -0 and 0 are equally high: 0
    return np.where(there, height, np.nan), np.where(there, variance, np.nan)


def _hits(
    points: NDArray[np.float64], corners: NDArray[np.int64], shape: tuple[int, ...]
) -> Iterator[tuple[tuple[NDArray[np.int64], NDArray[np.int64]], NDArray[np.float64], NDArray[np.float64]]]:
    """Yield nodes within triangles: (row, column), height and variance; item n has each triangle's n-th node."""
    x, y = points[:, 0][corners], points[:, 1][corners]
    left, right = np.maximum(np.ceil(x.min(axis=1)), 0), np.minimum(np.floor(x.max(axis=1)), shape[1] - 1)
    top, bottom = np.maximum(np.ceil(y.min(axis=1)), 0), np.minimum(np.floor(y.max(axis=1)), shape[0] - 1)
    own = np.flatnonzero((left <= right) & (top <= bottom))
    row = 0
    while len(rest := own[top[own] + row <= bottom[own]]):
        column = 0
        while len(now := rest[left[rest] + column <= right[rest]]):
            u, v = left[now] + column, top[now] + row
            x0, y0 = x[now, 0], y[now, 0]
            x1, y1, x2, y2 = x[now, 1] - x0, y[now, 1] - y0, x[now, 2] - x0, y[now, 2] - y0
            area = x1 * y2 - x2 * y1
            first = ((u - x0) * y2 - x2 * (v - y0)) / area
            second = (x1 * (v - y0) - (u - x0) * y1) / area
            inside = (first >= -EDGE) & (second >= -EDGE) & (first + second <= 1 + EDGE)
            node = v[inside].astype(np.int64), u[inside].astype(np.int64)
            zero, one, two = (points[corners[now[inside], k], 2:].T for k in range(3))
            yield node, *(zero + first[inside] * (one - zero) + second[inside] * (two - zero))
            column += 1
        row += 1


def fuse_layers(given: LayersInput) -> Sequence[NDArray[Any]]:
    """Return the planes, flags and sums of `FusedLayers`."""
    height, sigma, noise = given.height, given.sigma, given.noise
    known = np.isfinite(height)
    weight = np.where(known, 1 / np.maximum(sigma, np.float32(LEAST_LAYER_SIGMA)) ** 2, 0)
    middle = _weighted_quantile(height, weight, given.rank)
    agrees = known & (np.abs(height - middle) <= given.outlier * sigma + given.tolerance * _slope(middle))
    kept = np.where(agrees, weight, 0)
    total = kept.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (np.where(agrees, height, 0) * kept).sum(axis=0) / total
        own, shared = (
            np.sqrt((kept**2 * np.where(agrees, part, 0) ** 2).sum(axis=0)) / total for part in (sigma, noise)
        )
        several = agrees.sum(axis=0) >= 2
        chosen = agrees & several
        left = (height - mean) ** 2 / np.maximum(1 - kept / total, np.float32(LEAST_FREEDOM))
        shares = (kept**2).sum(axis=0) / total**2 * agrees.sum(axis=0)
    parts = (chosen, np.where(chosen, left, 0), np.where(chosen, sigma**2, 0), known & ~agrees)
    cells, single, claimed, outliers = (part.sum(axis=(0, 2), dtype=np.float64) for part in parts)
    fused = np.where(several, shares, 0).sum(axis=1, dtype=np.float64)
    sums = np.stack([cells, single, claimed, fused, outliers], axis=1)
    return mean, own, shared, np.asarray(known.any(axis=0), np.uint8), sums


def _weighted_quantile(
    height: NDArray[np.float32], weight: NDArray[np.float32], rank: float
) -> NDArray[np.float32]:
    """Return the weighted quantile (n, m), always one of the values."""
    order = np.argsort(height, axis=0)  # NaN goes last, with no weight
    ranked = np.take_along_axis(height, order, axis=0)
    reached = np.cumsum(np.take_along_axis(weight, order, axis=0), axis=0)
    pick = np.argmax(reached >= rank * reached[-1], axis=0)
    return np.take_along_axis(ranked, pick[None], axis=0)[0]


def _slope(middle: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the rise of the surface per cell (n, m); 0 where it is unknown."""
    if min(middle.shape) < 2:
        return np.zeros_like(middle)
    slope = np.hypot(*np.gradient(middle))
    return np.where(np.isfinite(slope), slope, 0)
