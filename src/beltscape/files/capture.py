"""Capture folders on disk: ``<capture>/<camera>/<frame>.<ext>``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from beltscape.core.errors import InputError
from beltscape.files.folders.manifest import require_finished
from beltscape.files.folders.paths import AnyPath, as_path, summarise_names
from beltscape.files.rasters.images import EXTENSIONS


@dataclass(frozen=True, slots=True)
class Capture:
    """The image files of a capture; the images are not read yet."""

    folder: Path
    files: Mapping[str, Mapping[str, Path]]
    """camera → frame → file, both in natural order."""

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the camera folders with images."""
        return tuple(self.files)

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of all frames of any camera, in natural order."""
        return sort_frames(self.files.values())

    def select_cameras(self, cameras: tuple[str, ...]) -> Capture:
        """Return the capture with only these cameras."""
        return Capture(self.folder, {name: self.files[name] for name in cameras if name in self.files})

    def describe_missing_frames(self) -> list[str]:
        """Return one line for each camera that lacks frames of another camera."""
        return describe_missing_frames(
            {str(self.folder / camera): files for camera, files in self.files.items()}
        )


def describe_missing_frames(files: Mapping[str, Mapping[str, object]]) -> list[str]:
    """Return one line for each camera folder that lacks frames of another; ``files``: by folder and frame."""
    frames = sort_frames(files.values())
    lines: list[str] = []
    for folder, own in files.items():
        missing = [frame for frame in frames if frame not in own]
        if missing:
            lines.append(f"{folder}: no image for frame {summarise_names(missing)}; going on without")
    return lines


def sort_frames(files: Iterable[Iterable[str]]) -> tuple[str, ...]:
    """Return the names of all frames that any of the cameras has, in natural order."""
    return tuple(sorted({frame for own in files for frame in own}, key=natural_key))


def natural_key(name: str) -> tuple[tuple[int, int | str], ...]:
    """Return a sort key that puts cal2 before cal10."""
    parts: list[tuple[int, int | str]] = []
    digits = ""
    for char in [*name, ""]:
        if char.isdigit() and char.isascii():
            digits += char
            continue
        if digits:
            parts.append((0, int(digits)))
            digits = ""
        parts.append((1, char))
    return (*parts, (2, name))


def read_capture(folder: AnyPath) -> Capture:
    """List the images of a capture folder; InputError if it has no camera folder with images."""
    folder = as_path(folder, "folder")
    if folder.is_file():
        raise InputError(f"{folder}: is a file; a capture is a folder <capture>/<camera>/<frame>.png")
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; a capture is <capture>/<camera>/<frame>.png")
    require_finished(folder)
    files: dict[str, dict[str, Path]] = {}
    for camera in sorted((p for p in folder.iterdir() if p.is_dir()), key=lambda p: natural_key(p.name)):
        images = list_images(camera)
        if images:
            files[camera.name] = images
    if not files:
        raise InputError(
            f"{folder}: no camera folder with images in it; a capture is <capture>/<camera>/<frame>.png"
        )
    return Capture(folder, files)


def list_images(camera: Path) -> dict[str, Path]:
    """Return the images of a folder by frame, in natural order; InputError if a frame is there twice."""
    images = index_images((path.name for path in camera.iterdir()), str(camera))
    return {frame: camera / name for frame, name in images.items()}


def index_images(names: Iterable[str], folder: str) -> dict[str, str]:
    """Return the images among the names of a folder's files by frame, in natural order.

    Raises
    ------
    InputError
        When a frame is there twice.
    """
    parts = (name.rpartition(".") for name in names if not name.startswith("."))
    found = [
        (stem, dot + extension) for stem, dot, extension in parts if (dot + extension).lower() in EXTENSIONS
    ]
    images: dict[str, str] = {}
    for stem, extension in sorted(found, key=lambda one: (natural_key(one[0]), one[1])):
        name = stem + extension
        if stem in images:
            raise InputError(
                f"{folder}/{name}: frame {stem} is there twice (also {images[stem]}); remove one of them"
            )
        images[stem] = name
    return images
