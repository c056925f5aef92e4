"""The images of one trigger instant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arguments import require_images

Image = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, slots=True, eq=False)
class FrameSet:
    """What the cameras saw at one trigger instant; a camera without an image is absent."""

    frame: str
    """Name of the instant: the image file's stem."""
    images: Mapping[str, Image]
    """By camera: (H, W) grey or (H, W, 3) RGB, uint8 or uint16."""
    time_ns: int | None = None
    """Trigger time where it is known, on a clock that never jumps."""
    position_mm: float | None = None
    """The encoder's reading at that instant; grows with the belt's travel; None where there is none."""

    def __post_init__(self) -> None:
        """Raise InputError where ``images`` are not images by camera."""
        require_images(self.images)


def to_grey(image: Image) -> NDArray[np.float32]:
    """(H, W) float32 luminance (Rec. 601) of a grey or RGB image, in the image's own counts."""
    if image.ndim == 2:
        return image.astype(np.float32)
    return image[..., :3].astype(np.float32) @ np.array([0.299, 0.587, 0.114], np.float32)


def saturated_fraction(image: Image) -> float:
    """Share of pixels at the top of the value range in any channel: what an overexposed view has too much of."""
    top = np.iinfo(image.dtype).max
    full = image >= top
    return float(np.mean(full if image.ndim == 2 else full.any(axis=-1)))
