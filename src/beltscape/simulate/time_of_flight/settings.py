"""What the time-of-flight camera is like."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Angle = Annotated[float, Field(gt=1, lt=150)]
Frequency = Annotated[float, Field(ge=1e6, le=1e9)]


class TofSettings(BaseModel):
    """The paper's camera in its geometry, an ordinary one in the rest."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    size_px: tuple[Annotated[int, Field(ge=8, le=4096)], Annotated[int, Field(ge=8, le=4096)]] = (640, 480)
    angle_deg: tuple[Angle, Angle] = (43.0, 33.0)
    """Horizontal and vertical angle of view."""
    modulation_hz: Annotated[tuple[Frequency, ...], Field(min_length=1, max_length=3)] = (25e6,)
    """Whole kHz; 25 MHz repeat after 6.0 m. Several together repeat after the range of their common divisor."""
    amplitude_e: Annotated[float, Field(gt=0, le=1e15)] = 100_000.0
    """Electrons of one of the four samples from a white surface that faces the camera at 1 m."""
    contrast: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Of the demodulation."""
    ambient_e: Annotated[float, Field(ge=0, le=1e12)] = 5_000.0
    """The same from a white surface by the hall's light."""
    read_noise_e: Annotated[float, Field(ge=0, le=1e6)] = 30.0
    full_well_e: Annotated[float, Field(gt=0)] = 400_000.0
    """Pixels with more are not measured."""
    min_amplitude_e: Annotated[float, Field(ge=0)] = 100.0
    """Pixels with less modulation are not measured."""
    harmonics: tuple[Annotated[float, Field(ge=-0.3, le=0.3)], Annotated[float, Field(ge=-0.3, le=0.3)]] = (
        0.006,
        0.002,
    )
    """Third and fifth, what the maker's own correction leaves of them: 0.006 make 6 mm of wiggling at 25 MHz."""
    intensity_error_mm: Annotated[float, Field(ge=-1000, le=1000)] = 4.0
    """Added to the distance in the dark limit."""
    intensity_half_e: Annotated[float, Field(gt=0)] = 5_000.0
    """Amplitude at which half of it is left."""
    scatter: Annotated[float, Field(ge=0, lt=1)] = 0.003
    """Share of the light that the lens spreads evenly over the image."""
    multipath: bool = True
    """Light over one second surface."""
    patch_px: Annotated[int, Field(ge=2, le=256)] = 16
    """Edge of the image blocks that stand for second surfaces."""
    receiver_px: Annotated[int, Field(ge=1, le=64)] = 4
    """Spacing of the pixels for which their light is summed; between them it is interpolated."""
