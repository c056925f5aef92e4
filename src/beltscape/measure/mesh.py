"""A depth map as a mesh of triangles, seen from straight above."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

_EDGE = 1e-9
"""A centre on the side that two triangles share belongs to both."""


def triangles(depth_mm: NDArray[np.float32], use: NDArray[np.bool_], step_mm: float) -> NDArray[np.int32]:
    """(M, 3) flat pixel indices of the triangles between neighbouring pixels (H, W) of one surface.

    A side joins two used pixels whose depths differ by no more than ``step_mm``; of a square's two diagonals the
    one from top right to bottom left is drawn where it joins.
    """
    index = np.arange(use.size, dtype=np.int32).reshape(use.shape)

    def joined(one: tuple[slice, slice], two: tuple[slice, slice]) -> NDArray[np.bool_]:
        with np.errstate(invalid="ignore"):
            return use[one] & use[two] & (np.abs(depth_mm[one] - depth_mm[two]) <= step_mm)

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


def from_above(
    places: NDArray[np.float64],
    values: NDArray[np.float64],
    corners: NDArray[np.int32],
    shape: tuple[int, int],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Top surface of a mesh at the nodes of a grid ``shape`` (Ny, Nx), NaN where there is none.

    ``places`` (N, 2) are the points in columns and rows of the grid, ``values`` (N, 2) their heights and another
    value; ``corners`` (M, 3) index them. Of several triangles over a node the highest counts, with its values
    interpolated: so what is vertical has no area, and what hangs over is solid.
    """
    height = np.full(shape[0] * shape[1], -np.inf)
    other = np.full(shape[0] * shape[1], np.nan)
    hits = list(_hits(places, corners, shape))
    for node, triangle, first, second in hits:
        np.maximum.at(height, node, _mixed(values[:, 0], corners[triangle], first, second))
    for node, triangle, first, second in hits:
        top = _mixed(values[:, 0], corners[triangle], first, second) >= height[node]
        other[node[top]] = _mixed(values[:, 1], corners[triangle[top]], first[top], second[top])
    return np.where(np.isfinite(height), height, np.nan).reshape(shape), other.reshape(shape)


def _mixed(
    values: NDArray[np.float64],
    corners: NDArray[np.int32],
    first: NDArray[np.float64],
    second: NDArray[np.float64],
) -> NDArray[np.float64]:
    zero, one, two = (values[corners[:, k]] for k in range(3))
    return zero + first * (one - zero) + second * (two - zero)


def _hits(
    places: NDArray[np.float64], corners: NDArray[np.int32], shape: tuple[int, int]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]]:
    """Nodes inside triangles: flat node, triangle, and weights of the second and third corner."""
    x, y = places[:, 0][corners], places[:, 1][corners]
    left, right = np.ceil(x.min(axis=1)), np.floor(x.max(axis=1))
    top, bottom = np.ceil(y.min(axis=1)), np.floor(y.max(axis=1))
    left, top = np.maximum(left, 0), np.maximum(top, 0)
    right, bottom = np.minimum(right, shape[1] - 1), np.minimum(bottom, shape[0] - 1)
    own = np.flatnonzero((left <= right) & (top <= bottom))
    row = 0
    while len(rest := own[top[own] + row <= bottom[own]]):
        column = 0
        while len(now := rest[left[rest] + column <= right[rest]]):
            u, v = left[now] + column, top[now] + row
            x0, y0 = x[now, 0], y[now, 0]
            x1, y1, x2, y2 = x[now, 1] - x0, y[now, 1] - y0, x[now, 2] - x0, y[now, 2] - y0
            with np.errstate(divide="ignore", invalid="ignore"):
                area = x1 * y2 - x2 * y1
                first = ((u - x0) * y2 - x2 * (v - y0)) / area
                second = (x1 * (v - y0) - (u - x0) * y1) / area
                inside = (first >= -_EDGE) & (second >= -_EDGE) & (first + second <= 1 + _EDGE)
            yield (
                (v[inside] * shape[1] + u[inside]).astype(np.int64),
                now[inside],
                first[inside],
                second[inside],
            )
            column += 1
        row += 1
