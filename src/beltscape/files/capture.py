"""Capture folders on disk: ``<capture>/<camera>/<frame>.<ext>``."""

from __future__ import annotations

from collections.abc import Mapping
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
        return tuple(sorted({frame for files in self.files.values() for frame in files}, key=natural_key))

    def select_cameras(self, cameras: tuple[str, ...]) -> Capture:
        """Return the capture with only these cameras."""
        return Capture(self.folder, {name: self.files[name] for name in cameras if name in self.files})

    def describe_missing_frames(self) -> list[str]:
        """Return one line for each camera that lacks frames of another camera."""
        lines: list[str] = []
        for camera, files in self.files.items():
            missing = [frame for frame in self.frames if frame not in files]
            if missing:
                shown = summarise_names(missing)
                lines.append(f"{self.folder / camera}: no image for frame {shown}; going on without")
        return lines


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
    paths = [p for p in camera.iterdir() if p.suffix.lower() in EXTENSIONS and not p.name.startswith(".")]
    images: dict[str, Path] = {}
    for path in sorted(paths, key=lambda p: (natural_key(p.stem), p.suffix)):
        if path.stem in images:
            raise InputError(
                f"{path}: frame {path.stem} is there twice (also {images[path.stem].name}); remove one of them"
            )
        images[path.stem] = path
    return images
