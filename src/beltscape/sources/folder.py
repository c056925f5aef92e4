"""Frame source that reads a recorded capture folder."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from functools import cached_property
from pathlib import Path

from beltscape.core.errors import InputError
from beltscape.core.frames import FrameSet, Image
from beltscape.core.progress import Reporter
from beltscape.files.capture import Capture
from beltscape.files.rasters.images import read_image
from beltscape.files.tables.exposures_csv import FILE as EXPOSURES
from beltscape.files.tables.exposures_csv import read_exposures

_KEPT_BYTES = 256 << 20
"""Bytes of images that are kept between two passes: five frames of five cameras of 3 MP in colour."""


class FolderSource:
    """The frames of a capture folder; unusable images are skipped with a warning that names them."""

    def __init__(self, capture: Capture, sizes_px: Mapping[str, tuple[int, int]], reporter: Reporter) -> None:
        """``sizes_px``: (width, height) that each camera's images must have; other cameras are not read."""
        self._capture = capture
        self._sizes_px = sizes_px
        self._reporter = reporter
        self._kept: dict[str, dict[str, Image]] = {}
        for name in sizes_px:
            if name not in capture.files:
                reporter.warn(describe_lost_camera(str(capture.folder), name))
        for line in capture.select_cameras(tuple(sizes_px)).describe_missing_frames():
            reporter.warn(line)

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras that have images."""
        return tuple(name for name in self._sizes_px if name in self._capture.files)

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of the frames, in natural order."""
        return self._capture.select_cameras(self.cameras).frames

    def __len__(self) -> int:
        return len(self.frames)

    def __repr__(self) -> str:
        return f"FolderSource({self.folder}: {len(self)} frames of {', '.join(self.cameras)})"

    @property
    def folder(self) -> Path:
        """The capture's folder."""
        return self._capture.folder

    def __iter__(self) -> Iterator[FrameSet]:
        return self.select_frames(self.frames)

    def select_frames(self, names: Collection[str]) -> Iterator[FrameSet]:
        """Yield the frames with these names, in natural order."""
        for frame in self.frames:
            if frame in names:
                yield FrameSet(frame, self.images(frame), exposures_us=self.exposures_us(frame))

    def preview_frames(self, names: Collection[str]) -> Iterator[FrameSet]:
        """Yield the frames with these names as `select_frames`; up to `_KEPT_BYTES` of images are read only once."""
        for frame_set in self.select_frames(names):
            kept = sum(image.nbytes for images in self._kept.values() for image in images.values())
            if kept + sum(image.nbytes for image in frame_set.images.values()) <= _KEPT_BYTES:
                self._kept[frame_set.frame] = dict(frame_set.images)
            yield frame_set

    def images(self, frame: str) -> dict[str, Image]:
        """Return the images of one frame by camera; empty without usable ones."""
        if frame in self._kept:
            return self._kept.pop(frame)
        images = {name: self._image(name, frame) for name in self.cameras}
        return {name: image for name, image in images.items() if image is not None}

    def files(self, frame: str) -> dict[str, Path]:
        """Return the files of one frame's images by camera, whether they can be used or not."""
        found = {name: self._capture.files[name].get(frame) for name in self.cameras}
        return {name: path for name, path in found.items() if path is not None}

    def exposures_us(self, frame: str) -> Mapping[str, float]:
        """Return by camera the exposure times of one frame, µs; empty where the capture does not state them."""
        return self._exposures_us.get(frame, {})

    @cached_property
    def _exposures_us(self) -> Mapping[str, Mapping[str, float]]:
        path = self.folder / EXPOSURES
        return read_exposures(path) if path.is_file() else {}

    def _image(self, camera: str, frame: str) -> Image | None:
        path = self._capture.files[camera].get(frame)
        if path is None:
            return None
        try:
            image = read_image(path)
            require_size(image, str(path), camera, self._sizes_px[camera])
        except InputError as error:
            self._reporter.warn(describe_lost_image(error))
            return None
        return image


def require_size(image: Image, name: str, camera: str, size_px: tuple[int, int]) -> None:
    """Raise InputError unless an image has the (width, height) of the rig's camera."""
    size, (width, height) = image.shape[1::-1], size_px
    if size != size_px:
        raise InputError(f"{name}: {size[0]}×{size[1]} px, but the rig's {camera} has {width}×{height}")


def describe_lost_image(error: InputError) -> str:
    """Return the warning of an image that cannot be used."""
    return f"{error}; going on without this image"


def describe_lost_camera(folder: str, camera: str) -> str:
    """Return the warning of a camera without images in a capture."""
    return f"{folder}/{camera}: no images of camera {camera}; going on without it"
