"""The [cameras] table of project.toml."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, model_validator

Name = Annotated[str, StringConstraints(min_length=1, strip_whitespace=True)]
PixelFormat = Literal[
    "Mono8", "Mono10", "Mono10Packed", "Mono10p", "Mono12", "Mono12Packed", "Mono12p", "Mono14", "Mono16", "RGB8",
    "BGR8", "BayerRG8", "BayerGR8", "BayerGB8", "BayerBG8", "BayerRG10", "BayerGR10", "BayerGB10", "BayerBG10",
    "BayerRG12", "BayerGR12", "BayerGB12", "BayerBG12", "BayerRG12Packed", "BayerGR12Packed", "BayerGB12Packed",
    "BayerBG12Packed", "BayerRG12p", "BayerGR12p", "BayerGB12p", "BayerBG12p", "BayerRG16", "BayerGR16",
    "BayerGB16", "BayerBG16",
]  # fmt: skip
"""GenICam's names of the pixel formats that are understood."""

WINDOW_SHARE = 0.4
"""Images within this share of the shortest time between instants may be of one instant."""


class CameraOverrides(BaseModel):
    """What one camera has of its own; what is not given is that of all."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    exposure_us: float | None = Field(None, gt=0, le=1e7)
    """Exposure time."""
    gain_db: float | None = Field(None, ge=-24, le=60)
    """Gain."""
    pixel_format: PixelFormat | None = None
    """What it sends."""
    offset_px: tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]] = (0, 0)
    """Left and upper edge of the part of the sensor that is read; the rig says its size."""


class EncoderSettings(BaseModel):
    """The belt's encoder, counted by the core camera. Exactly one of ``chunk`` and ``feature`` is given."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    mm_per_count: float = Field(allow_inf_nan=False)
    """Travel of the belt for a count; negative where the count falls as the belt goes forward."""
    chunk: Name | None = None
    """Chunk sent with every image, such as "CounterValue": the count when that image was taken."""
    feature: Name | None = None
    """Feature read right after every image, such as "CounterValue": late by some milliseconds of travel."""
    bits: int = Field(32, ge=8, le=64)
    """Bits after which the counter begins again."""

    @model_validator(mode="after")
    def _one_way(self) -> EncoderSettings:
        if (self.chunk is None) == (self.feature is None):
            raise ValueError('give either chunk or feature, such as chunk = "CounterValue"')
        if self.mm_per_count == 0:
            raise ValueError("mm_per_count must not be 0")
        return self


class CamerasSettings(BaseModel):
    """The cameras of a running system."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    devices: dict[Name, Name] = Field(min_length=1)
    """Name of the camera in the rig → its device id, address or serial number."""
    own: dict[Name, CameraOverrides] = {}
    """Name of the camera in the rig → what it has of its own."""
    exposure_us: float | None = Field(None, gt=0, le=1e7)
    """Exposure time; not given: as the camera stands."""
    gain_db: float | None = Field(None, ge=-24, le=60)
    """Gain; not given: as the camera stands."""
    pixel_format: PixelFormat = "Mono8"
    """What the cameras send."""
    trigger: Literal["software", "line", "free"] = "software"
    """software: this program calls each camera; line: a pulse on a wire to all; free: each by its own clock."""
    frames_per_s: float = Field(10.0, gt=0, le=1000)
    """software, free: frames a second; line: the most that may come in a second."""
    trigger_line: Name = "Line1"
    """Input of the trigger pulse."""
    trigger_activation: Literal["RisingEdge", "FallingEdge", "AnyEdge", "LevelHigh", "LevelLow"] = (
        "RisingEdge"
    )
    """What of the pulse triggers."""
    clocks: Literal["own", "ptp"] = "own"
    """own: each camera's clock is learned from its images' arrival; ptp: the cameras share one (IEEE 1588)."""
    allowed_skew_ms: float = Field(2.0, gt=0)
    """An image farther from the others of its instant is left out."""
    frame_timeout_ms: float = Field(300.0, ge=20, le=1000)
    """An instant waits this long for its last image; a camera that let it pass is not waited for any more."""
    packet_size: int | None = Field(None, ge=576, le=65535)
    """Bytes of a network packet; not given: the largest that comes through."""
    packet_delay_ns: int = Field(0, ge=0)
    """Pause of a camera between packets: it keeps cameras on one cable from drowning each other."""
    buffers: int = Field(12, ge=3, le=200)
    """Images of each camera that fit between network and program."""
    socket_buffer_bytes: int | None = Field(None, ge=65536)
    """Of each camera's socket; not given: as large as an image, as far as the system allows."""
    encoder: EncoderSettings | None = None
    """The belt's encoder, where the core camera counts it."""

    @model_validator(mode="after")
    def _fits(self) -> CamerasSettings:
        for name in self.own:
            if name not in self.devices:
                raise ValueError(
                    f"own.{name}: no such camera in devices; there are {', '.join(self.devices)}"
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

    def exposure_of(self, camera: str) -> float | None:
        """Exposure time of a camera in µs."""
        own = self.own.get(camera)
        return self.exposure_us if own is None or own.exposure_us is None else own.exposure_us

    def gain_of(self, camera: str) -> float | None:
        """Gain of a camera in dB."""
        own = self.own.get(camera)
        return self.gain_db if own is None or own.gain_db is None else own.gain_db

    def format_of(self, camera: str) -> PixelFormat:
        """Pixel format of a camera."""
        own = self.own.get(camera)
        return self.pixel_format if own is None or own.pixel_format is None else own.pixel_format

    def offset_of(self, camera: str) -> tuple[int, int]:
        """Left and upper edge of the part of the sensor that is read."""
        own = self.own.get(camera)
        return (0, 0) if own is None else own.offset_px
