"""Reference values of the images, kept over restarts, so that a fault from before a restart is still one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.errors import BeltscapeError, InputError
from beltscape.core.progress import Reporter
from beltscape.core.type_guards import is_dict
from beltscape.files.documents.digest import add_digest, require_digest
from beltscape.files.documents.json_text import read_json, to_json
from beltscape.files.folders.durable import keep_state
from beltscape.health.image_statistics import GRID, FloatArray
from beltscape.health.reference import CameraReference, ImageReferences, Reference
from beltscape.pipeline.live.images.optional_file import read_optional_file

FILE = "image_references.json"
FORMAT = "beltscape-image-references/1"
_FIX = "they are learned anew from the next frames"


def make_keeper(path: Path, key: Mapping[str, Any], reporter: Reporter) -> Callable[[ImageReferences], None]:
    """Return a function that keeps references for the system that ``key`` describes; a full disk is a warning."""
    return partial(_write, path, key, reporter)


def read_references(path: Path, key: Mapping[str, Any], reporter: Reporter) -> ImageReferences | None:
    """Return the references that an earlier run kept; None without any.

    Those of another system, with another ``key``, and a damaged file are named and not used.
    """

    def read() -> ImageReferences | None:
        document = read_json(path)
        if not is_dict(document) or document.get("format") != FORMAT:
            raise InputError(f"{path}: is no file of image references")
        require_digest(path, document, _FIX)
        changed = [name for name, value in key.items() if document.get(name) != value]
        if changed:
            reporter.warn(f"{path}: the {' and the '.join(changed)} changed since; {_FIX}")
            return None
        return _read_document(document)

    return read_optional_file(path, read, _FIX, reporter)


def _write(path: Path, key: Mapping[str, Any], reporter: Reporter, learned: ImageReferences) -> None:
    cameras = {
        name: {field.name: getattr(one, field.name) for field in fields(CameraReference)}
        for name, one in learned.reference.cameras.items()
    }
    document = {
        "format": FORMAT,
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


def _read_grid(values: Any) -> FloatArray:
    grid = np.array(values, np.float32)
    if grid.shape != GRID:
        raise ValueError(f"a grid has {grid.shape} values")
    return grid
