"""Frame sets, the images that all cameras took at one trigger instant, and the interface of their sources."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arguments import require_images
from beltscape.core.checks import require_text

Image = NDArray[np.uint8 | np.uint16]
_TOP_OF_12, _LOWEST_BITS = 1 << 12, 3
"""First value above 12 bits; the bits that are zero where 14 or fewer bits stand at the top of 16."""
OVEREXPOSED_SHARE = 0.2
"""Share of saturated pixels from which an image is called overexposed."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameSet:
    """The images of one trigger instant; a camera without an image is absent."""

    frame: str
    """Name of the instant: the image file's stem."""
    images: Mapping[str, Image]
    """By camera: (H, W) grey or (H, W, 3) RGB, uint8 or uint16; 12 bits of 16 are scaled by `fill_range`."""
    time_ns: int | None = None
    """Trigger time on a monotonic clock; None: not known."""
    position_mm: float | None = None
    """The encoder's position at that instant, growing with the belt's travel; None without a reading."""
    exposures_us: Mapping[str, float] = field(default_factory=dict[str, float])
    """By camera, exposure time of its image; NaN while it changes; empty where exposure times are not known."""
    recorded: str = ""
    """Name of the recorded frame that a replay shows, in a loop again and again; empty: the images are new."""

    def __repr__(self) -> str:
        return f"FrameSet({self.frame}: {', '.join(self.images)})"

    def __post_init__(self) -> None:
        """Raise InputError unless ``images`` maps camera names to images; fill the range of those of 12 bits."""
        require_text(self.frame, "frame")
        require_images(self.images)
        if any(image.dtype == np.uint16 for image in self.images.values()):
            filled = {name: fill_range(image) for name, image in self.images.items()}
            object.__setattr__(self, "images", filled)


def fill_range(image: Image) -> Image:
    """Return an image of 12 bits that is held as 0 to 4095 with its top value at 65535; others as they are.

    Levels, noise and saturation are judged by the range of the type, so such an image would seem 16 times too dark.
    Multiples of 4 are not changed: these are the dark images of cameras whose bits stand at the top.
    """
    if image.dtype != np.uint16 or image.max(initial=0) >= _TOP_OF_12 or not (image & _LOWEST_BITS).any():
        return image
    return ((image << 4) | (image >> 8)).astype(np.uint16, copy=False)


def to_grey(image: Image | NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the luminance (Rec. 601) (H, W) float32 of a grey or RGB image, in the image's own counts."""
    if image.ndim == 2:
        return image.astype(np.float32)
    return image[..., :3].astype(np.float32) @ np.array([0.299, 0.587, 0.114], np.float32)


def saturated_fraction(image: Image) -> float:
    """Return the share of pixels that are at the top of the value range in any channel."""
    top = np.iinfo(image.dtype).max
    full = image >= top
    return float(np.mean(full if image.ndim == 2 else full.any(axis=-1)))


class FrameSource(Protocol):
    """Source of frame sets in the order of their trigger instants."""

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of its cameras."""
        ...

    def __iter__(self) -> Iterator[FrameSet]: ...

    def __len__(self) -> int: ...
