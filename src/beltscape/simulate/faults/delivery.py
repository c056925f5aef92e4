"""Faults on the way from camera and encoder.

Images are missing, repeated, late, exchanged or mirrored; the encoder's faults are functions from true to faulty
readings.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from beltscape.simulate.faults.base import Fault, Seed


class MissingFrames(Fault):
    """A camera does not deliver every n-th frame."""

    camera: str
    every: Annotated[int, Field(ge=1)] = 1
    """Interval of the missing frames; 1: all of them."""

    def delivers(self, camera: str, frame: int) -> bool:
        """Return whether this camera delivers the frame of this number."""
        is_missing = camera == self.camera and frame >= self.first and (frame - self.first) % self.every == 0
        return not is_missing


class RepeatedImages(Fault):
    """A camera, or all, delivers the same image again and again."""

    camera: str = ""
    """Empty: every camera."""
    every: Annotated[int, Field(ge=0, le=1000)] = 0
    """Every n-th image is a new one, which is delivered n times; 0: none is."""
    noise: Annotated[float, Field(ge=0, le=100)] = 0.0
    """σ of fresh noise on a repeated image, in its values; 0: the repeated image has the same bytes."""
    last: Annotated[int, Field(ge=0, le=100_000)] | None = None
    """The last frame with the fault; None: it remains."""

    def is_active(self, frame: float) -> bool:
        """Return whether the fault is there in a frame."""
        return frame >= self.first and (self.last is None or frame <= self.last)

    def source_frame(self, frame: int) -> int:
        """Return the frame whose image is delivered."""
        if not self.is_active(frame):
            return frame
        if self.every:
            return frame - (frame - self.first) % self.every
        return max(self.first - 1, 0)


class LateCamera(Fault):
    """A camera that is not synchronous: it exposes before or after the others, or delivers an earlier frame."""

    camera: str
    late_ms: Annotated[float, Field(ge=-1e4, le=1e4)] = 0.0
    """Time by which it exposes later; a negative one: earlier."""
    frames: Annotated[int, Field(ge=0, le=100)] = 0
    """Number of frames by which its images are old: frame sets of two instants."""

    def source_frame(self, frame: int) -> int:
        """Return the frame whose image is delivered, without the lateness in milliseconds."""
        return max(frame - self.frames, 0) if self.is_active(frame) else frame


class ExchangedCameras(Fault):
    """Two cameras whose names or cables were exchanged."""

    cameras: tuple[str, str]


class MirroredImages(Fault):
    """A camera that delivers mirrored images."""

    camera: str
    vertically: bool = False
    """Whether top and bottom are exchanged, instead of left and right."""


EncoderKind = Literal["reversed", "frozen", "lifted", "jumping", "wild", "slip", "scale", "reset", "silent"]
_DEFAULT_SIZE = {"jumping": 500.0, "wild": 100.0, "slip": 0.03, "scale": 1.1}
"""Size of the faults that have one, where none is given."""


class EncoderFault(Fault):
    """A fault of the encoder.

    ========  ===================================================================================
    kind      effect on the readings from ``first`` to ``last``
    ========  ===================================================================================
    reversed  they count backwards
    frozen    they stand still; afterwards they jump to the true position
    lifted    they stand still; the travel is lost
    jumping   they jump once by ``size`` mm
    wild      every reading is off by random numbers of a standard deviation of ``size`` mm
    slip      they lose the share ``size`` of the travel
    scale     they count ``size`` times the travel
    reset     they begin again at 0
    silent    there are none
    ========  ===================================================================================
    """

    kind: EncoderKind
    size: Annotated[float, Field(ge=-1e6, le=1e6)] | None = None
    """See the table; None: jumping 500 mm, wild 100 mm, slip 0.03, scale 1.1."""
    last: Annotated[int, Field(ge=0, le=100_000)] | None = None
    """The last frame with the fault; None: it remains."""
    seed: Seed = 1

    def apply(self, position_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the readings (N,) of frames with these true positions (N,), mm; NaN: no reading."""
        position = np.asarray(position_mm, float)
        index = np.arange(len(position))
        active = (index >= self.first) & (index <= (len(position) if self.last is None else self.last))
        size = _DEFAULT_SIZE.get(self.kind, 0.0) if self.size is None else self.size
        factor = {"reversed": -1.0, "lifted": 0.0, "slip": 1 - size, "scale": size}.get(self.kind)
        if factor is not None:
            return _scale_travel(position, active, factor)
        held = position[max(self.first - 1, 0)] if len(position) else 0.0
        if self.kind == "frozen":
            return np.where(active, held, position)
        if self.kind == "jumping":
            return position + np.where(index >= self.first, size, 0.0)
        if self.kind == "wild":
            noise = np.random.default_rng(self.seed).normal(size=len(position))
            return position + np.where(active, size * noise, 0.0)
        if self.kind == "reset":
            return position - np.where(index >= self.first, held, 0.0)
        return np.where(active, np.nan, position)


def _scale_travel(
    position_mm: NDArray[np.float64], active: NDArray[np.bool_], factor: float
) -> NDArray[np.float64]:
    """Return positions whose steps into the active frames are scaled."""
    steps = np.diff(position_mm, prepend=position_mm[:1])
    scaled = np.where(active, factor * steps, steps)
    scaled[:1] = 0.0
    return position_mm[:1] + np.cumsum(scaled)
