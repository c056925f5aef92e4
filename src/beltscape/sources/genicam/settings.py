"""Settings of the [cameras] table of project.toml."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, model_validator

from beltscape.core.quantities import EXPOSURE, FRAME_RATE
from beltscape.sources.genicam.adaptive_exposure import AdaptiveExposureSettings

Exposure = Annotated[float, EXPOSURE]
Name = Annotated[str, StringConstraints(min_length=1, strip_whitespace=True)]
PixelFormat = Literal[
    "Mono8", "Mono10", "Mono10Packed", "Mono10p", "Mono12", "Mono12Packed", "Mono12p", "Mono14", "Mono16", "RGB8",
    "BGR8", "BayerRG8", "BayerGR8", "BayerGB8", "BayerBG8", "BayerRG10", "BayerGR10", "BayerGB10", "BayerBG10",
    "BayerRG12", "BayerGR12", "BayerGB12", "BayerBG12", "BayerRG12Packed", "BayerGR12Packed", "BayerGB12Packed",
    "BayerBG12Packed", "BayerRG12p", "BayerGR12p", "BayerGB12p", "BayerBG12p", "BayerRG16", "BayerGR16",
    "BayerGB16", "BayerBG16",
]  # fmt: skip
"""GenICam's names of the supported pixel formats."""

WINDOW_SHARE = 0.4
"""Images within this share of the shortest time between instants may belong to one instant; below a half, so that
they fit one only."""


class CameraOverrides(BaseModel):
    """Settings of one camera that override those of all cameras."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    exposure_us: Exposure | None = None
    """Exposure time."""
    gain_db: float | None = Field(default=None, ge=-24, le=60)
    """Gain."""
    pixel_format: PixelFormat | None = None
    """Pixel format that it sends."""
    offset_px: tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]] = (0, 0)
    """Left and upper edge of the part of the sensor that is read; its size is the rig's."""


class CameraEncoderSettings(BaseModel):
    """The belt's encoder, counted by the core camera. Exactly one of ``chunk`` and ``feature`` is given."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    mm_per_count: float = Field(allow_inf_nan=False)
    """Travel of the belt per count; negative if the count falls as the belt moves forward."""
    chunk: Name | None = None
    """Chunk sent with every image, such as "CounterValue": the count when that image was taken."""
    feature: Name | None = None
    """Feature read right after every image, such as "CounterValue": late by some milliseconds of travel."""
    bits: int = Field(default=32, ge=8, le=64)
    """Width of the counter in bits."""

    @model_validator(mode="after")
    def _check(self) -> CameraEncoderSettings:
        if (self.chunk is None) == (self.feature is None):
            raise ValueError('give either chunk or feature, such as chunk = "CounterValue"')
        if self.mm_per_count == 0:
            raise ValueError("mm_per_count must not be 0")
        return self


class CamerasSettings(BaseModel):
    """Settings of ``[cameras]``: the cameras of a running system."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    devices: dict[Name, Name] = Field(min_length=1)
    """Name of the camera in the rig → its device id, address or serial number."""
    own: dict[Name, CameraOverrides] = {}
    """Name of the camera in the rig → its own settings."""
    models: dict[Name, Name] = {}
    """Name of the camera in the rig → the maker's model and lens; cameras of one model start their calibration from a
    common lens. Not given: the model that the camera states."""
    lens_models: dict[Name, Literal["brown", "rational", "thin_prism", "tilted", "fisheye"]] = {}
    """Name of the camera in the rig → its lens model, such as tilted for a Scheimpflug adapter; not given: found."""
    exposure_us: Exposure | None = None
    """Exposure time; not given: the camera's present one."""
    gain_db: float | None = Field(default=None, ge=-24, le=60)
    """Gain; not given: the camera's present one."""
    pixel_format: PixelFormat = "Mono8"
    """Pixel format that the cameras send."""
    trigger: Literal["software", "line", "free"] = "software"
    """software: this program triggers each camera; line: a pulse on a wire to all; free: each by its own clock."""
    frames_per_s: Annotated[float, FRAME_RATE] = 10.0
    """software, free: frames per second; line: the highest rate of the pulses."""
    trigger_line: Name = "Line1"
    """Input of the trigger pulse."""
    trigger_activation: Literal["RisingEdge", "FallingEdge", "AnyEdge", "LevelHigh", "LevelLow"] = (
        "RisingEdge"
    )
    """Part of the pulse that triggers."""
    clocks: Literal["own", "ptp"] = "own"
    """own: each camera's clock is estimated from its images' arrival; ptp: the cameras share one (IEEE 1588)."""
    allowed_skew_ms: float = Field(default=2.0, gt=0)
    """An image farther from the others of its instant is skipped."""
    frame_timeout_ms: float = Field(default=300.0, ge=20, le=1000)
    """An instant waits this long for its last image; a camera that misses it is not waited for until it returns."""
    packet_size: int | None = Field(default=None, ge=576, le=65535)
    """Bytes of a network packet; not given: the largest that the network transmits."""
    packet_delay_ns: int = Field(default=0, ge=0)
    """Pause of a camera between packets, which prevents packet loss between cameras on one cable."""
    buffers: int = Field(default=12, ge=3, le=200)
    """Number of image buffers of each camera."""
    socket_buffer_bytes: int | None = Field(default=None, ge=65536)
    """Buffer of each camera's socket; not given: as large as an image, as far as the system allows."""
    encoder: CameraEncoderSettings | None = None
    """The belt's encoder, if the core camera counts it."""
    adaptive_exposure: AdaptiveExposureSettings | None = None
    """Bounds within which the exposure times follow the light; not given: they stay as they are."""

    @model_validator(mode="after")
    def _check(self) -> CamerasSettings:
        for table in ("own", "models", "lens_models"):
            for name in getattr(self, table):
                if name not in self.devices:
                    raise ValueError(
                        f"{table}.{name}: no such camera in devices; there are {', '.join(self.devices)}"
                    )
        if len(set(self.devices.values())) < len(self.devices):
            raise ValueError("devices: the same device is given twice")
        most_ms = WINDOW_SHARE * 1e3 / self.frames_per_s
        if self.allowed_skew_ms >= most_ms:
            raise ValueError(
                f"allowed_skew_ms {self.allowed_skew_ms:g} must be less than {most_ms:.3g} "
                f"({WINDOW_SHARE:g} of the time between frames); lower it or frames_per_s"
            )
        return self

    @model_validator(mode="after")
    def _check_adaptive_exposure(self) -> CamerasSettings:
        adaptive = self.adaptive_exposure
        for name in self.devices if adaptive is not None else ():
            exposure = self.exposure_of(name)
            if exposure is None:
                raise ValueError("adaptive_exposure: give exposure_us too, the exposure time at the start")
            if adaptive is not None and not adaptive.shortest_us <= exposure <= adaptive.longest_us:
                raise ValueError(
                    f"exposure_us = {exposure:g} of {name} is outside adaptive_exposure's "
                    f"{adaptive.shortest_us:g} to {adaptive.longest_us:g}"
                )
        return self

    def exposure_of(self, camera: str) -> float | None:
        """Return the exposure time of a camera in µs."""
        own = self.own.get(camera)
        return self.exposure_us if own is None or own.exposure_us is None else own.exposure_us

    @property
    def exposures_us(self) -> dict[str, float]:
        """Return the exposure times of all cameras; empty if that of any is not given."""
        given = {name: self.exposure_of(name) for name in self.devices}
        known = {name: us for name, us in given.items() if us is not None}
        return known if len(known) == len(given) else {}

    def gain_of(self, camera: str) -> float | None:
        """Return the gain of a camera in dB."""
        own = self.own.get(camera)
        return self.gain_db if own is None or own.gain_db is None else own.gain_db

    def format_of(self, camera: str) -> PixelFormat:
        """Return the pixel format of a camera."""
        own = self.own.get(camera)
        return self.pixel_format if own is None or own.pixel_format is None else own.pixel_format

    def offset_of(self, camera: str) -> tuple[int, int]:
        """Return the left and upper edge of the part of the sensor that is read."""
        own = self.own.get(camera)
        return (0, 0) if own is None else own.offset_px
