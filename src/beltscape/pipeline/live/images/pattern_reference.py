"""The projected pattern on the bare belt, kept over restarts, so that a projector that moved before one is named."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.errors import BeltscapeError
from beltscape.core.progress import Reporter
from beltscape.files.arrays import encode_arrays, read_arrays
from beltscape.files.folders.durable import keep_state
from beltscape.health.images.surface_checks.projector_position import LearnedPattern
from beltscape.pipeline.live.images.optional_file import read_optional_file

FILE = "projector_pattern.npz"
_FIX = "the projector's pattern is learned anew from the next frames"
_KEY, _HEIGHT, _TEXTURE = "key", "height_mm", "texture_"


def make_pattern_keeper(
    path: Path, key: Mapping[str, Any], reporter: Reporter
) -> Callable[[LearnedPattern], None]:
    """Return a function that keeps the pattern of the system that ``key`` describes; a full disk is a warning."""
    return partial(_write, path, key, reporter)


def read_pattern(path: Path, key: Mapping[str, Any], reporter: Reporter) -> LearnedPattern | None:
    """Return the pattern that an earlier run kept; None without any.

    That of another system, with another ``key``, and a damaged file are named and not used.
    """

    def read() -> LearnedPattern | None:
        arrays = read_arrays(path)
        kept = json.loads(str(arrays[_KEY]))
        if kept != _to_plain(key):
            reporter.warn(f"{path}: rig, empty belt or cameras changed since; {_FIX}")
            return None
        textures = {
            name.removeprefix(_TEXTURE): array.astype(np.float32)
            for name, array in arrays.items()
            if name.startswith(_TEXTURE)
        }
        return LearnedPattern(textures, float(arrays[_HEIGHT]))

    return read_optional_file(path, read, _FIX, reporter)


def _write(path: Path, key: Mapping[str, Any], reporter: Reporter, learned: LearnedPattern) -> None:
    textures = {f"{_TEXTURE}{name}": texture for name, texture in learned.textures.items()}
    described = {_KEY: np.array(json.dumps(_to_plain(key))), _HEIGHT: np.array(learned.height_mm)}
    try:
        keep_state(path, encode_arrays(**described, **textures))
    except BeltscapeError as error:
        reporter.warn(f"{error}; the projector's pattern is not kept")


def _to_plain(key: Mapping[str, Any]) -> Any:
    """Return the key as JSON reads it."""
    return json.loads(json.dumps(key))
