"""Base classes of faults: the frame in which a fault begins, its camera, and its growth over the frames."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Frames = Annotated[int, Field(ge=0, le=100_000)]
Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Degrees = Annotated[float, Field(ge=-180, le=180)]
Millimetres = Annotated[float, Field(ge=-1e4, le=1e4)]
Pixels = Annotated[float, Field(ge=-1e5, le=1e5)]


class Fault(BaseModel):
    """A fault that begins in a frame and remains."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    first: Frames = 0
    """The first frame with the fault."""

    def is_active(self, frame: float) -> bool:
        """Return whether the fault is there in a frame."""
        return frame >= self.first


class GrowingFault(Fault):
    """A fault that may grow from frame to frame."""

    grows_over: Frames = 0
    """Number of frames in which it grows evenly to its full size; 0: it is complete at once."""

    def extent_at(self, frame: float) -> float:
        """Return the share of its full size that the fault has in a frame, 0..1."""
        if not self.is_active(frame):
            return 0.0
        return min(1.0, (frame - self.first + 1) / self.grows_over) if self.grows_over else 1.0
