"""Capture folders on disk: ``<capture>/<camera>/<frame>.<ext>``."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from beltscape.core.errors import InputError
from beltscape.files.frame_names import match_frames, natural_key, sort_frames
from beltscape.files.images import EXTENSIONS, KINDS
from beltscape.files.output_folder import require_finished
from beltscape.files.paths import AnyPath, as_path, summarise_names

DEMO_FOLDER = Path(__file__).resolve().parents[1] / "data" / "demo"
"""The captures that ship with Beltscape: a small rig's, with their truth."""
_LAYOUT = "a capture is <capture>/<camera>/<frame>.png"
TRUTH = "truth"
"""Folder of a simulated capture beside those of its cameras, which holds no images of them."""
_SIMULATED = (TRUTH, "tof", "preview.png")
"""What `simulate` writes beside the cameras' folders; no image of a camera is lost with it."""
_LEFT_BY_SYSTEMS = ("thumbs.db", "desktop.ini", "__macosx", "@eadir", "lost+found", "$recycle.bin")
"""Names, in small letters, that Windows, macOS, ext4 and file servers leave in folders."""
_TEMPORARY = ("~", ".tmp", ".part", ".partial", ".crdownload")
"""Endings of files that a program is still writing, or kept as a copy."""
_DOCUMENTS = (
    ".csv", ".json", ".toml", ".txt", ".md", ".yaml", ".yml", ".xml", ".html", ".pdf", ".log", ".ini", ".rst"
)  # fmt: skip
"""Endings of tables and texts, which may lie beside the cameras' folders: they are no images."""
_ENDINGS_SHOWN = 4
"""Endings that a message lists by name at most; it stays one line."""


@dataclass(frozen=True, slots=True)
class Capture:
    """The image files of a capture; the images are not read yet."""

    folder: Path
    files: Mapping[str, Mapping[str, Path]]
    """camera → frame → file, both in natural order."""
    omissions: Mapping[str, tuple[str, ...]] = field(default_factory=dict[str, tuple[str, ...]])
    """Lines on what was left out or matched by numbers, by folder; "" for the capture itself."""

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
        omissions = {name: lines for name, lines in self.omissions.items() if name in ("", *cameras)}
        return Capture(
            self.folder, {name: self.files[name] for name in cameras if name in self.files}, omissions
        )

    def explain(self, *folders: str) -> str:
        """Return the first line on what was left out of these folders, in brackets behind a space; "" for nothing."""
        return next((f" ({line})" for name in folders for line in self.omissions.get(name, ())), "")

    def describe_omissions(self) -> list[str]:
        """Return one line for each folder of which something is not read, and for each camera that lacks frames."""
        left_out = [line for lines in self.omissions.values() for line in lines]
        files = {str(self.folder / camera): files for camera, files in self.files.items()}
        return [*left_out, *describe_missing_frames(files)]


def describe_missing_frames(files: Mapping[str, Mapping[str, object]]) -> list[str]:
    """Return one line for each camera folder that lacks frames of another; ``files``: by folder and frame."""
    frames = sort_frames(files.values())
    lines: list[str] = []
    for folder, own in files.items():
        missing = [frame for frame in frames if frame not in own]
        if missing:
            lines.append(f"{folder}: no image for frame {summarise_names(missing)}; going on without")
    return lines


def read_capture(folder: AnyPath, cameras: Collection[str] | None = None) -> Capture:
    """List the images of a capture folder under frame names that all ``cameras`` (None: all folders) share.

    Raises
    ------
    InputError
        When no camera folder has images, or it is unclear which images of the cameras are of one instant.
    """
    capture = list_capture(folder)
    synchronous = {name: files for name, files in capture.files.items() if cameras is None or name in cameras}
    matched, lines = match_frames(synchronous, str(capture.folder))
    files = {name: matched.get(name, own) for name, own in capture.files.items()}
    omissions = {
        name: (*capture.omissions.get(name, ()), *((lines[name],) if name in lines else ()))
        for name in {**capture.omissions, **lines}
    }
    return Capture(capture.folder, files, omissions)


def list_capture(folder: AnyPath) -> Capture:
    """List the images of a capture folder by their own names; InputError if it has no camera folder with images."""
    folder = as_path(folder, "folder")
    if folder.is_file():
        raise InputError(f"{folder}: is a file; a capture is a folder <capture>/<camera>/<frame>.png")
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; {_LAYOUT}")
    require_finished(folder)
    content = list_folder(folder)
    files: dict[str, dict[str, Path]] = {}
    omissions: dict[str, tuple[str, ...]] = {}
    for name in sorted(content.folders, key=natural_key):
        if not is_system_entry(name):
            images, line = list_camera(folder / name)
            if images:
                files[name] = images
            if line and name not in _SIMULATED:
                omissions[name] = (line,)
    loose = list_loose_files(content)
    if not files:
        raise InputError(_describe_emptiness(folder, omissions, loose))
    if loose:
        line = f"{folder}: {summarise_names(loose)} beside the cameras' folders: left out, {_LAYOUT}"
        omissions[""] = (line,)
    return Capture(folder, files, omissions)


def _describe_emptiness(folder: Path, omissions: Mapping[str, tuple[str, ...]], loose: list[str]) -> str:
    """Return why a folder without camera folders with images is no capture, by the first thing that it holds."""
    first = next((lines[0] for lines in omissions.values()), "")
    reason = f" (it holds {summarise_names(loose)})" if loose else f" ({first})" if first else ""
    return f"{folder}: no camera folder with images in it{reason}; {_LAYOUT}"


@dataclass(frozen=True, slots=True)
class FolderContent:
    """Names in a folder."""

    files: tuple[str, ...]
    folders: tuple[str, ...]
    others: tuple[str, ...]
    """Pipes, sockets, devices, and links to nothing: they are not opened."""


def list_folder(folder: Path) -> FolderContent:
    """Return the names in a folder by what they are; links are followed."""
    found: dict[str, list[str]] = {"file": [], "folder": [], "other": []}
    with os.scandir(folder) as entries:
        for entry in entries:
            kind = "folder" if entry.is_dir() else "file" if entry.is_file() else "other"
            found[kind].append(entry.name)
    return FolderContent(
        *(tuple(sorted(found[kind], key=natural_key)) for kind in ("file", "folder", "other"))
    )


def list_loose_files(content: FolderContent) -> list[str]:
    """Return the files of a capture's own folder but for tables, texts, `simulate`'s and an operating system's."""
    return [
        name
        for name in (*content.files, *content.others)
        if not is_system_entry(name) and name not in _SIMULATED and not name.lower().endswith(_DOCUMENTS)
    ]


def list_images(camera: Path) -> dict[str, Path]:
    """Return the images of a folder by frame, in natural order; InputError if a frame is there twice."""
    return list_camera(camera)[0]


def list_camera(camera: Path) -> tuple[dict[str, Path], str]:
    """Return the images of a camera's folder by frame, and a line on what is left out there; "" for nothing."""
    content = list_folder(camera)
    images = index_images(content.files, str(camera))
    return {frame: camera / name for frame, name in images.items()}, describe_left_out(str(camera), content)


def describe_left_out(folder: str, content: FolderContent) -> str:
    """Return one line on what is no readable image in a camera's folder, hidden files excepted; "" for nothing."""
    files = [name for name in content.files if not is_system_entry(name)]
    endings: dict[str, list[str]] = {}
    for name in files:
        if not name.lower().endswith(EXTENSIONS):
            endings.setdefault(Path(name).suffix.lower(), []).append(name)
    parts = [
        f"{len(names)} file{'s' * (len(names) > 1)} {ending or 'without an ending'} ({summarise_names(names, 2)})"
        for ending, names in list(endings.items())[:_ENDINGS_SHOWN]
    ]
    parts += ["files of other endings"] if len(endings) > _ENDINGS_SHOWN else []
    if folders := [name for name in content.folders if not is_system_entry(name)]:
        parts.append(f"folder{'s' * (len(folders) > 1)} {summarise_names(folders)}")
    if others := [name for name in content.others if not is_system_entry(name)]:
        parts.append(f"pipes, sockets, devices or links to nothing: {summarise_names(others)}")
    has_images = sum(map(len, endings.values())) < len(files)
    if not parts:
        return "" if has_images else f"{folder}: is empty; going on without it"
    lost = "" if has_images else ", and there is no other: going on without this folder"
    return f"{folder}: {'; '.join(parts)} cannot be read{lost}; images are {KINDS}"


def is_system_entry(name: str) -> bool:
    """Return whether a file or folder is hidden, temporary or an operating system's own."""
    small = name.lower()
    return small.startswith((".", "~", "#")) or small.endswith(_TEMPORARY) or small in _LEFT_BY_SYSTEMS


def index_images(names: Iterable[str], folder: str) -> dict[str, str]:
    """Return the images among the names of a folder's files by frame, in natural order.

    Raises
    ------
    InputError
        When a frame is there twice.
    """
    parts = (name.rpartition(".") for name in names if not is_system_entry(name))
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
