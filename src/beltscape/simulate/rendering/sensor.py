"""A camera sensor: from the light on its pixels to the values of the image file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal
from zlib import crc32

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

_RGGB = ((0, 1), (1, 2))
"""Channel by row and column of the colour mosaic (Bayer)."""


class Sensor(BaseModel):
    """The conversion of light to pixel values. The defaults give a noise of 1.5 of 255 at mid grey."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    colour: Literal["grey", "rgb", "bayer", "demosaiced"] = "grey"
    """Monochrome; three colours in every pixel; the raw RGGB mosaic; RGB interpolated from the mosaic."""
    bits: Literal[8, 12, 16] = 8
    """12 bits are stored in 16, as 0 … 4095."""
    electrons_at_1: Annotated[float, Field(gt=0, le=1e7)] = 12_000.0
    """Electrons from a white surface under ambient light of 1: exposure, aperture and quantum efficiency combined."""
    full_well_e: Annotated[float, Field(gt=0, le=1e7)] = 14_000.0
    """Electrons that saturate a pixel; at a gain of 1 they give the largest value."""
    gain: Annotated[float, Field(gt=0, le=100)] = 1.0
    """Gain of the amplifier."""
    read_noise_e: Annotated[float, Field(ge=0, le=1000)] = 5.0
    """Standard deviation."""
    shot_noise: bool = True
    """Whether photon shot noise is simulated."""
    black_level: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    """Value of a dark pixel, as a share of the largest value."""
    gamma: Annotated[float, Field(ge=1, le=4)] = 1.0
    """Values are light to the power of 1/gamma; 1 is linear."""


def expose(
    irradiance: NDArray[np.float32], sensor: Sensor, seed: int | Sequence[int]
) -> NDArray[np.uint8 | np.uint16]:
    """Return the image of a sensor under light (H, W, 3).

    Parameters
    ----------
    irradiance
        Linear RGB, 1 for a white surface under ambient light of 1.
    sensor
        The conversion of light to values.
    seed
        Of the noise; see `make_noise_seed`. The same seed gives the same image.

    Returns
    -------
    image
        (H, W), or (H, W, 3) RGB for a colour sensor; uint8, or uint16 for more than 8 bits.
    """
    generator = np.random.default_rng(seed)
    electrons = _apply_filter(irradiance, sensor) * np.float32(sensor.electrons_at_1)
    if sensor.shot_noise:
        electrons = generator.poisson(electrons).astype(np.float32)
    electrons = np.minimum(electrons, np.float32(sensor.full_well_e))
    if sensor.read_noise_e > 0:
        noise = generator.standard_normal(electrons.shape, dtype=np.float32)
        electrons = electrons + np.float32(sensor.read_noise_e) * noise
    signal = electrons * np.float32(sensor.gain / sensor.full_well_e)
    signal = sensor.black_level + (1 - sensor.black_level) * signal
    max_value = 2**sensor.bits - 1
    dtype = np.uint8 if sensor.bits == 8 else np.uint16
    level = np.clip(signal, 0.0, 1.0) ** (1 / sensor.gamma)
    image = np.rint(max_value * level).astype(dtype)
    return _demosaic(image) if sensor.colour == "demosaiced" else image


def make_noise_seed(seed: int, camera: str, frame: str) -> list[int]:
    """Return a separate seed for every image of a capture, independent of the order of rendering."""
    return [seed, crc32(camera.encode()), crc32(frame.encode())]


def _apply_filter(irradiance: NDArray[np.float32], sensor: Sensor) -> NDArray[np.float32]:
    """Return the light behind each pixel's colour filter: (H, W), or (H, W, 3) where each pixel has all three."""
    light = np.maximum(irradiance, np.float32(0))
    if sensor.colour == "rgb":
        return light
    if sensor.colour == "grey":
        return light.mean(axis=-1)  # no filter: all colours have equal weight
    mosaic = np.empty(light.shape[:2], np.float32)
    for row in (0, 1):
        for column in (0, 1):
            mosaic[row::2, column::2] = light[row::2, column::2, _RGGB[row][column]]
    return mosaic


def _demosaic(mosaic: NDArray[np.uint8 | np.uint16]) -> NDArray[np.uint8 | np.uint16]:
    import cv2

    return np.asarray(cv2.cvtColor(mosaic, cv2.COLOR_BayerRGGB2RGB), mosaic.dtype)
