"""References that a run learned from its images, kept over restarts; an engineer may renew them.

They are the reference values of the images, and the projected pattern on the bare belt: a fault from before a restart
is still one, and a projector that moved before it is named. Without such a file, or when it is damaged, the run goes
on.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from beltscape.core.arrays import Float32Array
from beltscape.core.checks import is_dict
from beltscape.core.errors import BeltscapeError, InputError
from beltscape.core.progress import Reporter
from beltscape.files.arrays import encode_arrays, read_arrays
from beltscape.files.atomic import describe_damage, keep_state, output_error, set_aside
from beltscape.files.json_text import add_digest, read_json, require_digest, to_json
from beltscape.health.image_statistics import GRID
from beltscape.health.images.projector_position import LearnedPattern
from beltscape.health.reference import CameraReference, ImageReferences, Reference


class LearningMonitor(Protocol):
    """A monitor that learns what sound images show."""

    def learn_anew(self) -> None:
        """Forget what was learned, before the next frame; any thread may call it."""
        ...


@dataclass(frozen=True, slots=True)
class LearnedImages:
    """The monitors that learn from images, and the files in which they keep it."""

    monitors: Sequence[LearningMonitor] = ()
    paths: Sequence[Path] = ()

    def learn_anew(self) -> bool:
        """Remove the files and let the monitors learn from the next sound frames; return whether anything learns.

        Raises
        ------
        OutputError
            When a file cannot be removed; then nothing is forgotten.
        """
        for path in self.paths:
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise output_error(path, error) from error
        for monitor in self.monitors:
            monitor.learn_anew()
        return bool(self.monitors)


Content = TypeVar("Content")


def read_optional_file(
    path: Path, read: Callable[[], Content | None], fix: str, reporter: Reporter
) -> Content | None:
    """Return what ``read`` finds in a file; None without it, and where it is damaged.

    A damaged file is set aside with a warning, of which ``fix`` is the end: what happens without the file. The errors
    of ``read`` name the fault alone.
    """
    if not path.is_file():
        return None
    try:
        return read()
    except Exception as error:
        reporter.warn(f"{set_aside(path, describe_damage(path, error))}; {fix}")
        return None


REFERENCES_FILE = "image_references.json"
REFERENCES_FORMAT = "beltscape-image-references/1"
_REFERENCES_FIX = "they are learned anew from the next frames"


def make_references_keeper(
    path: Path, key: Mapping[str, Any], reporter: Reporter
) -> Callable[[ImageReferences], None]:
    """Return a function that keeps references for the system that ``key`` describes; a full disk is a warning."""
    return partial(_write_references, path, key, reporter)


def read_references(path: Path, key: Mapping[str, Any], reporter: Reporter) -> ImageReferences | None:
    """Return the references that an earlier run kept; None without any.

    Those of another system, with another ``key``, and a damaged file are named and not used.
    """

    def read() -> ImageReferences | None:
        document = read_json(path)
        if not is_dict(document) or document.get("format") != REFERENCES_FORMAT:
            raise InputError(f"{path}: is no file of image references")
        require_digest(path, document)
        changed = [name for name, value in key.items() if document.get(name) != value]
        if changed:
            reporter.warn(f"{path}: the {' and the '.join(changed)} changed since; {_REFERENCES_FIX}")
            return None
        return _read_document(document)

    return read_optional_file(path, read, _REFERENCES_FIX, reporter)


def _write_references(
    path: Path, key: Mapping[str, Any], reporter: Reporter, learned: ImageReferences
) -> None:
    cameras = {
        name: {field.name: getattr(one, field.name) for field in fields(CameraReference)}
        for name, one in learned.reference.cameras.items()
    }
    document = {
        "format": REFERENCES_FORMAT,
        **key,
        "light": learned.light,
        "has_speckle": learned.reference.has_speckle,
        "cameras": cameras,
        "window_light": learned.window_light,
    }
    try:
        keep_state(path, to_json(add_digest(document)).encode())
    except BeltscapeError as error:
        reporter.warn(f"{error}; what the cameras normally show is not kept")


def _read_document(document: Mapping[str, Any]) -> ImageReferences:
    cameras = {str(name): _read_camera(values) for name, values in document["cameras"].items()}
    window_light = {str(name): _read_grid(grid) for name, grid in document["window_light"].items()}
    reference = Reference(cameras, bool(document["has_speckle"]))
    return ImageReferences(reference, window_light, float(document["light"]))


def _read_camera(values: Mapping[str, Any]) -> CameraReference:
    grids = ("level", "amplitude")
    numbers: dict[str, Any] = {
        name: _read_number(value) for name, value in values.items() if name not in grids
    }
    unknown = np.full(GRID, np.nan, np.float32)
    amplitude = _read_grid(values["amplitude"]) if "amplitude" in values else unknown
    return CameraReference(**numbers, level=_read_grid(values["level"]), amplitude=amplitude)


def _read_number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def _read_grid(values: Any) -> Float32Array:
    grid = np.array(values, np.float32)
    if grid.shape != GRID:
        raise ValueError(f"a grid has {grid.shape} values")
    return grid


PATTERN_FILE = "projector_pattern.npz"
_PATTERN_FIX = "the projector's pattern is learned anew from the next frames"
_KEY, _HEIGHT, _TEXTURE = "key", "height_mm", "texture_"


def make_pattern_keeper(
    path: Path, key: Mapping[str, Any], reporter: Reporter
) -> Callable[[LearnedPattern], None]:
    """Return a function that keeps the pattern of the system that ``key`` describes; a full disk is a warning."""
    return partial(_write_pattern, path, key, reporter)


def read_pattern(path: Path, key: Mapping[str, Any], reporter: Reporter) -> LearnedPattern | None:
    """Return the pattern that an earlier run kept; None without any.

    That of another system, with another ``key``, and a damaged file are named and not used.
    """

    def read() -> LearnedPattern | None:
        arrays = read_arrays(path)
        kept = json.loads(str(arrays[_KEY]))
        if kept != _to_plain(key):
            reporter.warn(f"{path}: rig, empty belt or cameras changed since; {_PATTERN_FIX}")
            return None
        textures = {
            name.removeprefix(_TEXTURE): array.astype(np.float32)
            for name, array in arrays.items()
            if name.startswith(_TEXTURE)
        }
        return LearnedPattern(textures, float(arrays[_HEIGHT]))

    return read_optional_file(path, read, _PATTERN_FIX, reporter)


def _write_pattern(path: Path, key: Mapping[str, Any], reporter: Reporter, learned: LearnedPattern) -> None:
    textures = {f"{_TEXTURE}{name}": texture for name, texture in learned.textures.items()}
    described = {_KEY: np.array(json.dumps(_to_plain(key))), _HEIGHT: np.array(learned.height_mm)}
    try:
        keep_state(path, encode_arrays(**described, **textures))
    except BeltscapeError as error:
        reporter.warn(f"{error}; the projector's pattern is not kept")


def _to_plain(key: Mapping[str, Any]) -> Any:
    """Return the key as JSON reads it."""
    return json.loads(json.dumps(key))
