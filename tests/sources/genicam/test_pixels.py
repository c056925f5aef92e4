"""Decoding of packed and mosaic pixels."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import InputError
from beltscape.sources.genicam.pixels import FORMATS, decode_image, scale_to_full_range

CODES = {one.name: code for code, one in FORMATS.items()}


def bits_of(values: np.ndarray, bits: int) -> np.ndarray:
    """(n, bits) the bits of values, the lowest first."""
    return values[:, None] >> np.arange(bits) & 1


def packed(values: np.ndarray, bits: int) -> bytes:
    """GigE Vision's packing, written from its table, pixel by pixel."""
    low = bits - 8
    out = bytearray()
    for a, b in values.reshape(-1, 2).tolist():
        out += bytes([a >> low, (b & (1 << low) - 1) << 4 | (a & (1 << low) - 1), b >> low])
    return bytes(out)


def streamed(values: np.ndarray, bits: int) -> bytes:
    """PFNC's "p": one stream of bits, the lowest first."""
    return np.packbits(bits_of(values, bits).ravel().astype(np.uint8), bitorder="little").tobytes()


@given(
    st.sampled_from([10, 12]),
    st.sampled_from(["Packed", "p", ""]),
    st.integers(1, 9),
    st.integers(0, 2**32 - 1),
)
def test_deep_pixels_are_the_same_in_every_packing(bits, packing, height, seed):
    values = np.random.default_rng(seed).integers(0, 1 << bits, 8 * height)
    write = {"Packed": packed, "p": streamed, "": lambda v, _: v.astype("<u2").tobytes()}[packing]
    image = decode_image(write(values, bits), CODES[f"Mono{bits}{packing}"], (8, height))
    assert image.dtype == np.uint16
    np.testing.assert_array_equal(image >> (16 - bits), values.reshape(height, 8))


def test_odd_numbers_of_pixels_fill_up_the_last_group():
    values = np.arange(15) * 250
    image = decode_image(streamed(values, 12), CODES["Mono12p"], (5, 3))
    np.testing.assert_array_equal(image >> 4, values.reshape(3, 5))
    image = decode_image(packed(np.append(values, 0), 12), CODES["Mono12Packed"], (5, 3))
    np.testing.assert_array_equal(image >> 4, values.reshape(3, 5))


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_the_whole_range_is_used_evenly(bits):
    wide = scale_to_full_range(np.arange(1 << bits, dtype=np.uint16), bits).astype(int)
    assert (wide[0], wide[-1]) == (0, 65535)
    steps = np.diff(wide)
    assert steps.min() >= 1 << (16 - bits)
    assert steps.max() <= (1 << (16 - bits)) + 1


@pytest.mark.parametrize("start", ["RG", "GR", "GB", "BG"])
@pytest.mark.parametrize(
    ("suffix", "bits"), [("8", 8), ("12", 12), ("12p", 12), ("12Packed", 12), ("16", 16)]
)
def test_colours_come_from_their_mosaic_pixels(start, suffix, bits):
    colour = {"R": 0.8, "G": 0.4, "B": 0.1}
    pattern = {"RG": "RGGB", "GR": "GRBG", "GB": "GBRG", "BG": "BGGR"}[start]
    top = (1 << bits) - 1
    tile = np.array([round(colour[c] * top) for c in pattern]).reshape(2, 2)
    plane = np.tile(tile, (8, 8)).ravel()
    if suffix == "12p":
        data = streamed(plane, 12)
    elif suffix == "12Packed":
        data = packed(plane, 12)
    else:
        data = plane.astype(np.uint8 if bits == 8 else "<u2").tobytes()
    image = decode_image(data, CODES[f"Bayer{start}{suffix}"], (16, 16))
    assert image.shape == (16, 16, 3)
    full = np.iinfo(image.dtype).max
    np.testing.assert_allclose(
        image[4:-4, 4:-4] / full, np.broadcast_to([0.8, 0.4, 0.1], (8, 8, 3)), atol=0.003
    )


def test_plain_images_are_the_camera_s_bytes():
    rng = np.random.default_rng(1)
    grey = rng.integers(0, 256, (6, 7), dtype=np.uint8)
    colour = rng.integers(0, 256, (6, 7, 3), dtype=np.uint8)
    np.testing.assert_array_equal(decode_image(grey.tobytes() + b"chunk", CODES["Mono8"], (7, 6)), grey)
    np.testing.assert_array_equal(decode_image(colour.tobytes(), CODES["RGB8"], (7, 6)), colour)
    backwards = cv2.cvtColor(colour, cv2.COLOR_RGB2BGR)
    np.testing.assert_array_equal(decode_image(backwards.tobytes(), CODES["BGR8"], (7, 6)), colour)


def test_unsupported_or_short_buffer_is_refused():
    with pytest.raises(InputError, match="0x02100032 is not supported"):
        decode_image(b"", 0x02100032, (2, 2))
    with pytest.raises(InputError, match=r"4×2 Mono12Packed has 11 bytes instead of 12"):
        decode_image(bytes(11), CODES["Mono12Packed"], (4, 2))


def test_codes_are_aravis_s():
    from beltscape.core.errors import SettingsError
    from beltscape.sources.genicam.aravis import load_aravis

    try:
        lib = load_aravis()
    except SettingsError as error:
        pytest.skip(str(error))
    for name in ("MONO_8", "MONO_10", "MONO_12", "MONO_14", "MONO_16", "MONO_10_PACKED", "MONO_12_PACKED"):
        assert FORMATS[getattr(lib, f"PIXEL_FORMAT_{name}")].name == name.replace(
            "_PACKED", "Packed"
        ).replace("MONO_", "Mono")
    for start in ("RG", "GR", "GB", "BG"):
        for bits, suffix in (
            ("8", ""),
            ("10", ""),
            ("12", ""),
            ("16", ""),
            ("12_PACKED", "Packed"),
            ("12P", "p"),
        ):
            code = getattr(lib, f"PIXEL_FORMAT_BAYER_{start}_{bits}")
            number = bits.partition("_")[0].rstrip("P")
            assert FORMATS[code].name == f"Bayer{start}{number}{suffix}"
