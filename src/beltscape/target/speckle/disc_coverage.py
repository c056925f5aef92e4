"""Anti-aliased discs: each pixel gets the exact share of its area that the disc covers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

CHUNK = 1 << 20
"""Pixel corners processed at once."""


def compute_disc_coverage(size_px: tuple[int, int], discs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sum of the discs' weights times the share of each pixel that they cover.

    Parameters
    ----------
    size_px
        Width and height. Pixel (0, 0) is the square of side 1 centred on (0, 0).
    discs
        (N, 4) x, y, radius > 0, weight; px. Parts outside the image are cut off.

    Returns
    -------
    (H, W) float64; exact but for rounding, so that a disc wholly inside sums up to weight · π · radius².
    """
    width, height = size_px
    image = np.zeros(width * height)
    spans = np.ceil(2 * discs[:, 2]).astype(np.int64) + 1  # pixels that a disc can touch in a row
    for span in np.unique(spans):
        same_span = discs[spans == span]
        step = max(CHUNK // int(span + 1) ** 2, 1)
        for start in range(0, len(same_span), step):
            _add_discs(image, size_px, same_span[start : start + step], int(span))
    return image.reshape(height, width)


def _add_discs(
    image: NDArray[np.float64], size_px: tuple[int, int], discs: NDArray[np.float64], span: int
) -> None:
    """Add (n, 4) discs, each within span × span pixels, to the flat image."""
    width, height = size_px
    x, y, radius, weight = discs.T
    column, row = np.rint(x - radius).astype(np.int64), np.rint(y - radius).astype(np.int64)
    corner = np.arange(span + 1) - 0.5
    u = ((column - x)[:, None] + corner) / radius[:, None]
    v = ((row - y)[:, None] + corner) / radius[:, None]
    below = _area_below(u, v) * (radius * radius * weight)[:, None, None]
    share = np.diff(np.diff(below, axis=1), axis=2)
    columns, rows = column[:, None] + np.arange(span), row[:, None] + np.arange(span)
    inside = ((rows >= 0) & (rows < height))[:, :, None] & ((columns >= 0) & (columns < width))[:, None, :]
    index = (rows * width)[:, :, None] + columns[:, None, :]
    image += np.bincount(index[inside], share[inside], minlength=image.size)


def _area_below(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n, rows, columns) area of the unit disc left of u (n, columns) and above v (n, rows)."""
    u, v = np.clip(u, -1, 1)[:, None, :], np.clip(v, -1, 1)[:, :, None]
    half = np.sqrt(1 - v * v)  # the chord at v reaches from -half to half
    end = np.clip(u, -half, half)
    cap = (
        _integrate_half_chord(end) - _integrate_half_chord(-half) - np.abs(v) * (end + half)
    )  # beyond |v|, left of u
    return np.where(v < 0, cap, 2 * _integrate_half_chord(u) - cap)


def _integrate_half_chord(u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ∫ √(1 - t²) dt from 0 to u."""
    return (u * np.sqrt(1 - u * u) + np.arcsin(u)) / 2
