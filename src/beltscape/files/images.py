"""Reading of images (PNG, TIFF, JPEG, BMP, PGM/PPM, WebP, JPEG 2000), writing of the first four; reading of videos.

Images have 8 or 16 bit; videos are decoded frame by frame with OpenCV.
"""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import cast
from zlib import crc32

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError
from beltscape.core.frames import Image, fill_range
from beltscape.files.atomic import write_bytes
from beltscape.files.paths import AnyPath, as_path

WRITTEN = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp")
"""File name extensions of the images that are written."""
EXTENSIONS = (*WRITTEN, ".pgm", ".ppm", ".pnm", ".webp", ".jp2")
"""File name extensions of the images that are read."""
KINDS = "PNG, TIFF, JPEG, BMP, PGM, PPM, WebP and JPEG 2000"
"""Names of the formats that are read, for messages."""

_PNG, _PNG_KIND, _INDEXED = b"\x89PNG\r\n\x1a\n", 25, 3
"""A PNG's first bytes; offset of its colour type; the type with a palette (PNG specification, 11.2.1)."""
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of TIFF (TIFF 6.0, section 2) and BigTIFF."""
_NO_PAGE = 1 | 4
"""Bits of a TIFF's NewSubfileType: a reduced image, a mask (TIFF 6.0, section 8)."""
_HEAD = 4096
"""Bytes at a file's beginning in which a mark of animation is searched; it stands before the first image's data."""
_CHUNK = 12
"""Bytes of a PNG's chunk beside its data: length, type and checksum of four each (PNG specification, 5.3)."""

# InputError describes damaged images in one line; OpenCV's own messages are switched off
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


def read_image(path: AnyPath) -> Image:
    """Read an image (H, W) or (H, W, 3) RGB, uint8 or uint16; InputError with the file's name if it is unusable.

    An image of 12 bits in the lower bits of 16 is scaled to the whole range.
    """
    path = as_path(path)
    if path.exists() and not path.is_file() and not path.is_dir():
        raise InputError(f"{path}: is a pipe, socket or device, which is not opened; give an image file")
    try:
        data = np.fromfile(path, dtype=np.uint8)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    return _decode(data, str(path))


def decode_image(data: bytes, name: str) -> Image:
    """Decode the bytes of an image file as `read_image`; InputError with the name if they are unusable."""
    return _decode(np.frombuffer(data, np.uint8), name)


def _decode(data: NDArray[np.uint8], name: str) -> Image:
    if data.size == 0:
        raise InputError(f"{name}: the file is empty (0 bytes); copy the image again")
    if _is_damaged_png(data):
        raise InputError(f"{name}: the file is damaged or cut short; copy the image again")
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    if image is None:
        raise InputError(f"{name}: not a readable image; {KINDS} are known")
    pages = _count_pages(data)
    if pages > 1:
        raise InputError(
            f"{name}: holds {pages} pages, and an image file is one frame; save each page as an image of its own "
            "(ImageJ: File, Save As, Image Sequence)"
        )
    if image.dtype not in (np.dtype(np.uint8), np.dtype(np.uint16)):
        raise InputError(f"{name}: pixels are {image.dtype}; 8 or 16 bit images are needed")
    if image.ndim == 3:
        is_grey = image.shape[2] < 3 or (_has_palette(data) and is_grey_throughout(image))
        image = image[..., 0] if is_grey else image[..., 2::-1]
    return fill_range(cast(Image, np.ascontiguousarray(image)))


def is_grey_throughout(image: Image) -> bool:
    """Return whether the colour channels of (H, W, 3 or 4) are equal in every pixel."""
    return bool((image[..., 0] == image[..., 1]).all() and (image[..., 1] == image[..., 2]).all())


def _has_palette(data: NDArray[np.uint8]) -> bool:
    """Return whether the bytes are a PNG with a palette, as some tools save images of few levels."""
    return data[: len(_PNG)].tobytes() == _PNG and len(data) > _PNG_KIND and data[_PNG_KIND] == _INDEXED


def _count_pages(data: NDArray[np.uint8]) -> int:
    """Return the number of images in the file's bytes, without thumbnails and masks; 1 if it cannot be counted."""
    head = data[:_HEAD].tobytes()
    if head[:4] in _TIFF:
        import tifffile

        try:
            with tifffile.TiffFile(BytesIO(data.tobytes())) as file:
                pages = [page for page in file.pages if isinstance(page, tifffile.TiffPage)]
                return sum(not page.subfiletype & _NO_PAGE for page in pages)
        except (ValueError, LookupError):
            return 1  # OpenCV has read its first page
    is_animated = {
        b"GIF8": True,
        b"RIFF": b"ANIM" in head,  # of WebP
        _PNG[:4]: b"acTL" in head.partition(b"IDAT")[0],
    }
    if is_animated.get(head[:4], False):
        read, animation = cv2.imdecodeanimation(data)
        return len(animation.frames) if read else 1
    return 1


def _is_damaged_png(data: NDArray[np.uint8]) -> bool:
    """Return whether a PNG is truncated or has a wrong checksum, which libpng only prints to standard error."""
    view, start = data.data, len(_PNG)
    if bytes(view[:start]) != _PNG:
        return False
    while start + _CHUNK <= len(data):
        end = start + _CHUNK + int.from_bytes(view[start : start + 4], "big")
        if crc32(view[start + 4 : end - 4]) != int.from_bytes(view[end - 4 : end], "big") or end > len(data):
            return True
        if bytes(view[start + 4 : start + 8]) == b"IEND":
            return False
        start = end
    return True


def encode_image(image: Image, extension: str = ".png") -> bytes:
    """Return the encoded bytes of a grey or RGB image; InputError if the format cannot hold it."""
    extensions = WRITTEN if image.dtype == np.uint8 else WRITTEN[:3]  # JPEG and BMP would drop the lower bits
    if extension.lower() not in extensions:
        raise InputError(
            f"{image.dtype} images cannot be stored as {extension!r}; use {', '.join(extensions)}"
        )
    bgr = image if image.ndim == 2 else np.ascontiguousarray(image[..., ::-1])
    return cv2.imencode(extension, bgr)[1].tobytes()


def write_image(path: AnyPath, image: Image) -> None:
    """Write a grey or RGB image, atomically, in the format of the extension."""
    path = as_path(path)
    write_bytes(path, encode_image(image, path.suffix))


VIDEO_EXTENSIONS = (".mp4", ".avi", ".mov", ".mkv", ".m4v", ".webm", ".mpg", ".mpeg", ".mjpeg")
"""File name extensions of videos that OpenCV's decoder reads."""


def read_video(path: Path) -> Iterator[NDArray[np.uint8]]:
    """Yield the frames (H, W, 3) uint8 RGB of a video; InputError if it cannot be opened or holds no frame."""
    video = cv2.VideoCapture(str(path))
    try:
        count = 0
        while video.isOpened():
            read, frame = video.read()
            if not read:
                break
            count += 1
            yield np.ascontiguousarray(frame[:, :, ::-1], np.uint8)
        if count == 0:
            raise InputError(
                f"{path}: no frame of this video can be decoded; convert it to H.264 in an .mp4 file"
            )
    finally:
        video.release()
