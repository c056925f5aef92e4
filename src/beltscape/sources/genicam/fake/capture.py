"""The images of a capture with the belt's counts, for simulated cameras."""

from __future__ import annotations

from pathlib import Path

from beltscape.core.errors import InputError
from beltscape.core.frames import Image
from beltscape.files.capture import read_capture
from beltscape.files.rasters.images import is_grey_throughout, read_image
from beltscape.files.tables.encoder_csv import read_encoder


def read_pictures(folder: Path, mm_per_count: float) -> tuple[dict[str, list[Image]], list[int], int]:
    """Return each camera's images of the common frames, the belt's counts at them, and the counts of one cycle.

    The counts are empty without an encoder.csv. InputError if no frame has images of all cameras.
    """
    capture = read_capture(folder)
    frames = [f for f in capture.frames if all(f in files for files in capture.files.values())]
    if not frames:
        raise InputError(f"{folder}: no frame that all cameras have")
    pictures = {name: _read_uniform([files[f] for f in frames]) for name, files in capture.files.items()}
    counts = _counts(folder / "encoder.csv", frames, mm_per_count)
    if len(counts) < 2:
        return pictures, [], 0
    # from the last image to the first one the belt travels as far as between two others on average
    return pictures, counts, counts[-1] - counts[0] + round((counts[-1] - counts[0]) / (len(counts) - 1))


def _read_uniform(files: list[Path]) -> list[Image]:
    """Read a camera's images, which must have one size and pixel format; all become grey if one of them is.

    Raises
    ------
    InputError
        When one differs from the first; the error names the file.
    """
    images = [read_image(path) for path in files]
    if any(image.ndim == 2 for image in images):
        images = [
            image[..., 0].copy() if image.ndim == 3 and is_grey_throughout(image) else image
            for image in images
        ]
    first = images[0]
    for path, image in zip(files, images, strict=True):
        if image.shape != first.shape or image.dtype != first.dtype:
            raise InputError(
                f"{path}: {_describe_format(image)}, but {files[0]} is {_describe_format(first)}; "
                "a camera sends images of one form"
            )
    return images


def _describe_format(image: Image) -> str:
    colour = "grey" if image.ndim == 2 else "RGB"
    return f"{image.shape[1]}×{image.shape[0]} px {colour} {8 * image.itemsize} bit"


def _counts(path: Path, frames: list[str], mm_per_count: float) -> list[int]:
    if not path.is_file():
        return []
    position = {reading.frame: reading.belt_position_mm for reading in read_encoder(path)}
    missing = [f for f in frames if f not in position]
    if missing:
        raise InputError(f"{path}: no row for frame {missing[0]}")
    return [round(position[f] / mm_per_count) for f in frames]
