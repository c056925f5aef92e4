"""Video files, decoded frame by frame with OpenCV."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError

EXTENSIONS = (".mp4", ".avi", ".mov", ".mkv", ".m4v", ".webm", ".mpg", ".mpeg", ".mjpeg")
"""File name extensions of videos that OpenCV's decoder reads."""


def read_video(path: Path) -> Iterator[NDArray[np.uint8]]:
    """Yield the frames (H, W, 3) uint8 RGB of a video; InputError if it cannot be opened or holds no frame."""
    import cv2

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
