"""Frame sets: grey levels, luminance and saturation of images."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.frames import FrameSet, saturated_fraction, to_grey


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_grey_images_keep_their_counts(dtype):
    image = np.array([[0, 7], [200, 255]], dtype)
    assert to_grey(image).dtype == np.float32
    np.testing.assert_array_equal(to_grey(image), image)


def test_luminance_is_rec_601_in_the_order_rgb():
    red, green, blue = np.eye(3, dtype=np.uint8)[:, None, None, :] * np.uint8(100)
    assert [float(to_grey(c)[0, 0]) for c in (red, green, blue)] == pytest.approx(
        [29.9, 58.7, 11.4], abs=1e-4
    )


def test_saturation_counts_a_pixel_once_whatever_its_channels():
    image = np.zeros((2, 2, 3), np.uint8)
    image[0, 0] = 255
    image[1, 1, 2] = 255
    assert saturated_fraction(image) == 0.5
    assert saturated_fraction(np.array([[65535, 65534]], np.uint16)) == 0.5
    assert saturated_fraction(np.full((2, 2), 255, np.uint16)) == 0.0


def test_images_of_12_bits_in_memory_fill_the_range_as_those_of_files() -> None:
    """Cameras' own libraries give 12 bits as 0 to 4095."""
    stored = np.arange(4096, dtype=np.uint16).reshape(64, 64)
    eight = np.full((64, 64), 7, np.uint8)
    frame = FrameSet("000", {"cam0": stored, "cam1": eight})
    assert frame.images["cam0"].max() == 65535
    assert frame.images["cam1"] is eight
    again = FrameSet("001", frame.images)
    np.testing.assert_array_equal(again.images["cam0"], frame.images["cam0"])
