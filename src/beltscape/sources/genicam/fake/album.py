"""The images of one simulated camera in a memory-mapped file, which a new process opens at once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from beltscape.core.errors import InputError
from beltscape.core.frames import Image


def write_album(path: Path, images: Sequence[Image]) -> None:
    """Write images of one size and type."""
    first = images[0]
    album = np.lib.format.open_memmap(path, "w+", first.dtype, (len(images), *first.shape))
    for index, image in enumerate(images):
        if image.shape != first.shape or image.dtype != first.dtype:
            raise InputError(
                f"picture {index}: {image.shape} {image.dtype} among {first.shape} {first.dtype}"
            )
        album[index] = image
    album.flush()


def read_album(path: Path) -> Image:
    """Return the images (n, H, W) or (n, H, W, 3), read from the disk on access."""
    return np.load(path, mmap_mode="r")


def pixel_format(image: Image) -> str:
    """Return GenICam's name of the format that transmits an image unchanged."""
    if image.ndim == 3:
        return "RGB8"
    return "Mono8" if image.dtype == np.uint8 else "Mono16"
