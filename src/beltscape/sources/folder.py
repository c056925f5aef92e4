"""Frame source that reads a recorded capture folder."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from functools import cached_property
from itertools import islice
from pathlib import Path

from beltscape.core.errors import InputError
from beltscape.core.frames import FrameSet, Image
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.rig import Rig, fit_camera, replace_scaled_cameras, scale_camera
from beltscape.core.progress import Reporter
from beltscape.files.capture import Capture, read_capture
from beltscape.files.exposures_csv import FILE as EXPOSURES
from beltscape.files.exposures_csv import read_exposures
from beltscape.files.images import read_image
from beltscape.files.paths import summarise_names
from beltscape.workers.processes import ProcessTask, open_process_pool

_KEPT_BYTES = 256 << 20
"""Bytes of images that are kept between two passes: five frames of five cameras of 3 MP in colour."""
_AHEAD = 2
"""Frames that another process reads ahead."""
_SIZED_IMAGES = 5
"""Images of a camera that are read to find their size where the first one has not that of the rig."""
_NO_SIZE_PX = (0, 0)
"""Where no size is expected."""


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
                reporter.warn(describe_lost_camera(str(capture.folder), name, capture.cameras, sizes_px))
        for line in capture.select_cameras(tuple(sizes_px)).describe_omissions():
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

    def read_ahead(self, frames: Iterable[str]) -> Iterator[dict[str, Image]]:
        """Yield the images of frames as `images`, read by another process while this one does something else."""
        waiting: deque[tuple[str, ProcessTask]] = deque()
        with open_process_pool(_read_files, None, 1) as pool:
            for frame in frames:
                files = {name: (path, self._sizes_px[name]) for name, path in self.files(frame).items()}
                waiting.append((frame, pool.submit(files, frame)))
                if len(waiting) > _AHEAD:
                    yield self._take(*waiting.popleft())
            while waiting:
                yield self._take(*waiting.popleft())

    def _take(self, frame: str, task: ProcessTask) -> dict[str, Image]:
        """Return the images that were read, with warnings of those that cannot be used."""
        read: dict[str, Image | str] | None = task.result().value
        if read is None:
            return self.images(frame)
        for image in read.values():
            if isinstance(image, str):
                self._reporter.warn(image)
        return {name: image for name, image in read.items() if not isinstance(image, str)}

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
        image = _read_file(camera, path, self._sizes_px[camera])
        if isinstance(image, str):
            self._reporter.warn(image)
            return None
        return image


def _read_files(shared: None, files: Mapping[str, tuple[Path, tuple[int, int]]]) -> dict[str, Image | str]:
    """Return by camera the image of a file with its (width, height), or the warning of one that cannot be used."""
    del shared
    return {camera: _read_file(camera, *file) for camera, file in files.items()}


def _read_file(camera: str, path: Path, size_px: tuple[int, int]) -> Image | str:
    try:
        image = read_image(path)
        require_size(image, str(path), camera, size_px)
    except InputError as error:
        return describe_lost_image(error)
    return image


def scale_rig_to_capture(rig: Rig, folder: Path, reporter: Reporter) -> Rig:
    """Return the rig with its cameras scaled to the images of a capture, as `scale_rig_to_images` does."""
    capture = read_capture(folder, rig.cameras)
    found = {
        name: choose_image_size(_read_sizes(capture.files[name].values()), camera.size_px)
        for name, camera in rig.cameras.items()
        if name in capture.files
    }
    return scale_rig_to_images(
        rig, {name: size for name, size in found.items() if size}, str(folder), reporter
    )


def _read_sizes(files: Iterable[Path]) -> Iterator[tuple[int, int]]:
    """Yield the (width, height) of the images that can be read."""
    for path in files:
        with suppress(InputError):
            height, width = read_image(path).shape[:2]
            yield width, height


def find_image_size(files: Iterable[Path]) -> tuple[int, int] | None:
    """Return the (width, height) of most of the first few images that can be read; None without any."""
    return choose_image_size(_read_sizes(files), _NO_SIZE_PX)


def choose_image_size(
    sizes_px: Iterable[tuple[int, int]], expected_px: tuple[int, int]
) -> tuple[int, int] | None:
    """Return the expected size if one of the first few images has it, else that of most of them; None without any.

    No more images are read than needed.
    """
    counts: Counter[tuple[int, int]] = Counter()
    for size in islice(sizes_px, _SIZED_IMAGES):
        if size == expected_px:
            return size
        counts[size] += 1
    return counts.most_common(1)[0][0] if counts else None


def scale_rig_to_images(
    rig: Rig, sizes_px: Mapping[str, tuple[int, int]], place: str, reporter: Reporter
) -> Rig:
    """Return the rig with its cameras scaled to images of the sizes (width, height); a warning says so.

    Cameras without a size take that of the core's factor, so that all others can still be compared. An auxiliary
    camera whose images are cropped or turned keeps its size, so that they are left out; a warning names it.

    Raises
    ------
    InputError
        When the core camera's images have another aspect ratio than the rig's: they are cropped or turned.
    """
    changed = {name: size for name, size in sizes_px.items() if size != rig.cameras[name].size_px}
    scaled: dict[str, Camera] = {}
    texts: dict[str, list[str]] = {}
    for name, size in changed.items():
        camera = rig.cameras[name]
        fitted = fit_camera(camera, size)
        if fitted is None:
            text = f"{place}/{name}: {_describe_crop(name, size, camera.size_px)}"
            if name == rig.core:
                raise InputError(text)
            reporter.warn(f"{text}; going on without these images")
            continue
        scaled[name] = fitted
        texts.setdefault(
            f"images of {_format(size)} px, the rig's are {_format(camera.size_px)}; the rig is scaled by "
            f"{fitted.focal_px[0] / camera.focal_px[0]:.6g}",
            [],
        ).append(name)
    if rig.core in scaled:
        factor = scaled[rig.core].focal_px[0] / rig.core_camera.focal_px[0]
        others = {name: rig.cameras[name] for name in rig.cameras if name not in sizes_px}
        scaled |= {name: scale_camera(camera, factor) for name, camera in others.items()}
    if not scaled:
        return rig
    for text, names in texts.items():
        is_whole = set(names) == set(sizes_px)
        reporter.warn(f"{place}: {text}" if is_whole else f"{place}: {', '.join(names)}: {text}")
    return replace_scaled_cameras(rig, scaled)


def _describe_crop(name: str, size_px: tuple[int, int], own_px: tuple[int, int]) -> str:
    sizes = f"images are {_format(size_px)} px, the rig's {name} has {_format(own_px)}"
    if size_px == own_px[::-1]:
        return f"{sizes}: they are turned by a quarter; switch the rotation off in the camera, or calibrate again"
    return (
        f"{sizes}: they are cropped, or of another camera; images of the whole sensor, or binned in both directions "
        "alike, fit the rig; for these, calibrate with images of the same region"
    )


def _format(size_px: tuple[int, int]) -> str:
    return f"{size_px[0]}×{size_px[1]}"


def require_size(image: Image, name: str, camera: str, size_px: tuple[int, int]) -> None:
    """Raise InputError unless an image has the (width, height) of the rig's camera."""
    size, (width, height) = image.shape[1::-1], size_px
    if size != size_px:
        raise InputError(f"{name}: {size[0]}×{size[1]} px, but the rig's {camera} has {width}×{height}")


def describe_lost_image(error: InputError) -> str:
    """Return the warning of an image that cannot be used."""
    return f"{error}; going on without this image"


def describe_lost_camera(
    folder: str, camera: str, folders: Iterable[str] = (), cameras: Collection[str] = ()
) -> str:
    """Return the warning of a camera without images in a capture, which names ``folders`` that are no camera's."""
    others = [name for name in folders if name not in cameras]
    note = f" ({summarise_names(others)} in the capture is no camera of the rig)" if others else ""
    return f"{folder}/{camera}: no images of camera {camera}{note}; going on without it"
