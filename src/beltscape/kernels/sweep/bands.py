"""The cut of an image into overlapping bands of rows, the same for any number of threads."""

from __future__ import annotations

from typing import NamedTuple

BAND_ROWS = 64
"""Rows of a band, of which each is aggregated by itself; its costs fit the memory that a thread may use."""
HALO_ROWS = 16
"""Rows beyond a band from which its paths begin."""


class Band(NamedTuple):
    """Rows first … last - 1 of which keep_first … keep_last - 1 are kept."""

    first: int
    keep_first: int
    keep_last: int
    last: int


def bands(height: int) -> list[Band]:
    """Return bands whose kept rows cover ``height`` rows once."""
    return [
        Band(max(0, y - HALO_ROWS), y, end, min(height, end + HALO_ROWS))
        for y in range(0, height, BAND_ROWS)
        for end in [min(height, y + BAND_ROWS)]
    ]
