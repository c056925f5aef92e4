"""Images that are missing, repeated, late, exchanged or mirrored on their way from the camera."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from beltscape.simulate.faults.base import Fault


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
