"""Decoding of a camera's buffers: unpacking, scaling to the full range of the type, demosaicing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError
from beltscape.core.frames import Image

Packing = Literal["none", "gige", "lsb"]
"""one pixel per word; GigE Vision's "Packed", two pixels in three bytes; PFNC's "p", a stream of bits"""


@dataclass(frozen=True, slots=True)
class Format:
    """One pixel format (PFNC, https://www.emva.org GenICam Pixel Format Naming Convention 2.1)."""

    name: str
    bits: int
    packing: Packing = "none"
    pattern: str = ""
    """Colours of the upper left 2×2 pixels, row by row; empty without a colour mosaic."""
    channels: int = 1


def _bayer(codes: dict[str, int], bits: int, packing: Packing, suffix: str) -> dict[int, Format]:
    rows = {"GR": "GRBG", "RG": "RGGB", "GB": "GBRG", "BG": "BGGR"}
    return {
        code: Format(f"Bayer{start}{bits}{suffix}", bits, packing, rows[start])
        for start, code in codes.items()
    }


FORMATS: dict[int, Format] = {
    0x01080001: Format("Mono8", 8),
    0x01100003: Format("Mono10", 10),
    0x010C0004: Format("Mono10Packed", 10, "gige"),
    0x010A0046: Format("Mono10p", 10, "lsb"),
    0x01100005: Format("Mono12", 12),
    0x010C0006: Format("Mono12Packed", 12, "gige"),
    0x010C0047: Format("Mono12p", 12, "lsb"),
    0x01100025: Format("Mono14", 14),
    0x01100007: Format("Mono16", 16),
    0x02180014: Format("RGB8", 8, channels=3),
    0x02180015: Format("BGR8", 8, channels=3),
    **_bayer({"GR": 0x01080008, "RG": 0x01080009, "GB": 0x0108000A, "BG": 0x0108000B}, 8, "none", ""),
    **_bayer({"GR": 0x0110000C, "RG": 0x0110000D, "GB": 0x0110000E, "BG": 0x0110000F}, 10, "none", ""),
    **_bayer({"GR": 0x01100010, "RG": 0x01100011, "GB": 0x01100012, "BG": 0x01100013}, 12, "none", ""),
    **_bayer({"GR": 0x0110002E, "RG": 0x0110002F, "GB": 0x01100030, "BG": 0x01100031}, 16, "none", ""),
    **_bayer({"GR": 0x010C002A, "RG": 0x010C002B, "GB": 0x010C002C, "BG": 0x010C002D}, 12, "gige", "Packed"),
    **_bayer({"GR": 0x010C0057, "RG": 0x010C0059, "GB": 0x010C0055, "BG": 0x010C0053}, 12, "lsb", "p"),
}
"""By the code in the image's header."""


def decode_image(data: bytes, code: int, size_px: tuple[int, int]) -> Image:
    """Return the image (H, W) or (H, W, 3) RGB of a buffer; uint8 from 8 bits, else uint16 with a top value of 65535.

    ``size_px`` is (width, height) from the image's header. InputError: unknown format, or too few bytes.
    """
    format_ = FORMATS.get(code)
    if format_ is None:
        raise InputError(f"pixel format {code:#010x} is not supported; set pixel_format, such as Mono8")
    width, height = size_px
    count = width * height * format_.channels
    size = (count * format_.bits + 7) // 8 if format_.packing == "lsb" else _count_bytes(format_, count)
    if len(data) < size:
        raise InputError(f"image of {width}×{height} {format_.name} has {len(data)} bytes instead of {size}")
    values: Any = scale_to_full_range(
        unpack(np.frombuffer(data, np.uint8, size), format_, count), format_.bits
    )
    if format_.channels == 3:
        colours = values.reshape(height, width, 3)
        return np.ascontiguousarray(colours[..., ::-1]) if format_.name.startswith("BGR") else colours
    plane = values.reshape(height, width)
    return demosaic(plane, format_.pattern) if format_.pattern else plane


def _count_bytes(format_: Format, count: int) -> int:
    if format_.packing == "gige":
        return (count + 1) // 2 * 3
    return count if format_.bits <= 8 else 2 * count


def unpack(raw: NDArray[np.uint8], format_: Format, count: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Return the values (count,) of a buffer's bytes, in the format's own range."""
    if format_.packing == "gige":
        return _unpack_gige(raw, format_.bits)[:count]
    if format_.packing == "lsb":
        return _unpack_lsb(raw, format_.bits, count)
    return raw if format_.bits <= 8 else raw.view(np.dtype("<u2"))


def _unpack_gige(raw: NDArray[np.uint8], bits: int) -> NDArray[np.uint16]:
    """Unpack two pixels of three bytes; the middle byte has the low bits of both, the first's in its lower half."""
    low = bits - 8
    first, both, second = raw.reshape(-1, 3).astype(np.uint16).T
    mask = (1 << low) - 1
    pair = [(first << low) | (both & mask), (second << low) | (both >> 4 & mask)]
    return np.stack(pair, axis=-1, dtype=np.uint16).ravel()


def _unpack_lsb(raw: NDArray[np.uint8], bits: int, count: int) -> NDArray[np.uint16]:
    """Unpack consecutive pixels from the lowest bit on, in groups that fill whole bytes."""
    pixels, size = (2, 3) if bits == 12 else (4, 5)
    groups = -(-count // pixels)
    filled = np.zeros(groups * size, np.uint8)
    filled[: len(raw)] = raw
    columns = filled.reshape(groups, size).astype(np.uint32)
    out = np.empty((groups, pixels), np.uint16)
    for pixel in range(pixels):
        byte, shift = divmod(pixel * bits, 8)
        out[:, pixel] = (columns[:, byte] | columns[:, byte + 1] << 8) >> shift & ((1 << bits) - 1)
    return out.ravel()[:count]


def scale_to_full_range(
    values: NDArray[np.uint8] | NDArray[np.uint16], bits: int
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Keep 8 bits; scale more to 16, with 0 at 0 and the top value at 65535 (the high bits repeat below)."""
    if bits <= 8 or bits == 16:
        return values
    wide = values.astype(np.uint16)
    return ((wide << (16 - bits)) | (wide >> (2 * bits - 16))).astype(np.uint16, copy=False)


def demosaic(plane: NDArray[np.uint8] | NDArray[np.uint16], pattern: str) -> Image:
    """Return RGB (H, W, 3) of a colour mosaic (H, W) with the 2×2 ``pattern``, by bilinear interpolation."""
    import cv2

    return cv2.cvtColor(plane, getattr(cv2, f"COLOR_Bayer{pattern}2RGB"))
