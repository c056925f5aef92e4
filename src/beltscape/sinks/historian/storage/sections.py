"""Compression of cross-sections: heights in steps of 1/32 mm, as differences, deflated."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

STEP_MM = 1 / 32
"""Heights are exact to half of that, far below a camera's resolution; the grid is stored exactly."""
_LIMIT_MM = 2.0**24
"""Largest height that fits: 16 km, which no belt reaches."""


def round_heights(height_mm: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return heights (Nx,) float32 rounded as they will read back; NaN stays NaN."""
    clipped = np.clip(height_mm.astype(np.float64), -_LIMIT_MM, _LIMIT_MM)
    return (np.rint(clipped / STEP_MM) * STEP_MM).astype(np.float32)


def pack_heights(height_mm: NDArray[np.float32]) -> bytes:
    """Compress heights (Nx,) float32, NaN = not measured, to bytes."""
    absent = np.isnan(height_mm)
    steps = np.rint(round_heights(np.where(absent, np.float32(0), height_mm)) / STEP_MM).astype(np.int64)
    # a hole repeats the last height: its difference is 0
    places = np.maximum.accumulate(np.where(absent, 0, np.arange(len(steps)))) if len(steps) else steps
    differences = np.diff(steps[places], prepend=0).astype("<i4")
    shuffled = differences.view(np.uint8).reshape(-1, 4).T
    return struct.pack("<I", len(steps)) + zlib.compress(
        np.packbits(absent).tobytes() + shuffled.tobytes(), level=6
    )


def unpack_heights(data: bytes) -> NDArray[np.float32]:
    """Return the heights (Nx,) float32 of ``pack_heights``; ValueError for invalid bytes."""
    try:
        (count,) = struct.unpack_from("<I", data)
        body = np.frombuffer(zlib.decompress(data[4:]), np.uint8)
    except (struct.error, zlib.error) as error:
        raise ValueError(str(error)) from error
    bits = (count + 7) // 8
    if len(body) != bits + 4 * count:
        raise ValueError(f"{len(body)} bytes for {count} heights")
    differences = np.ascontiguousarray(body[bits:].reshape(4, count).T).view("<i4")[:, 0]
    height = (np.cumsum(differences, dtype=np.int64) * STEP_MM).astype(np.float32)
    height[np.unpackbits(body[:bits], count=count).astype(bool)] = np.nan
    return height
