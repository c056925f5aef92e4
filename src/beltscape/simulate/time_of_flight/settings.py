"""Settings of the simulated time-of-flight camera."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Angle = Annotated[float, Field(gt=1, lt=150)]
Frequency = Annotated[float, Field(ge=1e6, le=1e9)]


class TofSettings(BaseModel):
    """The geometry of the paper's camera; all other values are those of a typical camera."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    size_px: tuple[Annotated[int, Field(ge=8, le=4096)], Annotated[int, Field(ge=8, le=4096)]] = (640, 480)
    angle_deg: tuple[Angle, Angle] = (43.0, 33.0)
    """Horizontal and vertical angle of view."""
    modulation_hz: Annotated[tuple[Frequency, ...], Field(min_length=1, max_length=3)] = (25e6,)
    """Whole kHz; the range of 25 MHz is 6.0 m. Several frequencies have the range of their common divisor."""
    amplitude_e: Annotated[float, Field(gt=0, le=1e15)] = 100_000.0
    """Electrons in one of the four samples from a white surface that faces the camera at 1 m."""
    contrast: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Demodulation contrast."""
    ambient_e: Annotated[float, Field(ge=0, le=1e12)] = 5_000.0
    """Electrons in one of the four samples from a white surface under the ambient light."""
    read_noise_e: Annotated[float, Field(ge=0, le=1e6)] = 30.0
    full_well_e: Annotated[float, Field(gt=0)] = 400_000.0
    """Pixels with more electrons are not measured."""
    min_amplitude_e: Annotated[float, Field(ge=0)] = 100.0
    """Pixels with a smaller amplitude are not measured."""
    harmonics: tuple[Annotated[float, Field(ge=-0.3, le=0.3)], Annotated[float, Field(ge=-0.3, le=0.3)]] = (
        0.006,
        0.002,
    )
    """Third and fifth harmonic after the maker's correction: 0.006 causes 6 mm of wiggling at 25 MHz."""
    intensity_error_mm: Annotated[float, Field(ge=-1000, le=1000)] = 4.0
    """Error of the distance in the limit of dark pixels."""
    intensity_half_e: Annotated[float, Field(gt=0)] = 5_000.0
    """Amplitude at which half of this error is left."""
    scatter: Annotated[float, Field(ge=0, lt=1)] = 0.003
    """Share of the light that the lens scatters evenly over the image."""
    multipath: bool = True
    """Whether light over one second surface is simulated."""
    patch_px: Annotated[int, Field(ge=2, le=256)] = 16
    """Edge of the image blocks that represent second surfaces."""
    receiver_px: Annotated[int, Field(ge=1, le=64)] = 4
    """Spacing of the pixels at which the light from second surfaces is computed; it is interpolated in between."""
