"""Reading and writing of intrinsics.json, lenses of cameras and their covariances (``beltscape-intrinsics/1``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.arrays import Array
from beltscape.core.checks import is_dict
from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.files.json_text import parse_numbers, read_json, write_json
from beltscape.files.paths import AnyPath, as_path, read_text
from beltscape.files.rig_json import describe_lens, parse_camera

FORMAT = "beltscape-intrinsics/1"


@dataclass(frozen=True, slots=True, eq=False)
class Intrinsics:
    """Lenses of cameras by name."""

    cameras: Mapping[str, Camera]
    covariances: Mapping[str, Array] = field(default_factory=dict[str, Array])
    """(W, W) of fx, fy, cx, cy and the coefficients of the lens model; absent where unknown."""
    quality: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Figures of each camera's calibration."""


def write_intrinsics(path: AnyPath, intrinsics: Intrinsics) -> None:
    """Write intrinsics, atomically, with full float precision."""
    write_json(as_path(path), intrinsics_document(intrinsics))


def intrinsics_document(intrinsics: Intrinsics) -> dict[str, Any]:
    """Return the document of intrinsics.json."""
    return {
        "format": FORMAT,
        "cameras": {
            name: {
                "size_px": list(camera.size_px),
                "focal_px": camera.focal_px,
                "center_px": camera.center_px,
                **describe_lens(camera),
                **({"covariance": intrinsics.covariances[name]} if name in intrinsics.covariances else {}),
                **({"quality": intrinsics.quality[name]} if name in intrinsics.quality else {}),
            }
            for name, camera in intrinsics.cameras.items()
        },
    }


def is_intrinsics_file(path: Path) -> bool:
    """Return whether a file is an intrinsics.json, of whatever name."""
    return path.is_file() and path.suffix == ".json" and f'"{FORMAT}"' in read_text(path)[:200]


def read_intrinsics_file(path: AnyPath) -> Intrinsics:
    """Read intrinsics.json; InputError with the first invalid key."""
    path = as_path(path)
    document = read_json(path)
    if not is_dict(document) or document.get("format") != FORMAT:
        raise InputError(
            f"{path}: is not {FORMAT!r}; give an intrinsics.json of beltscape calibrate intrinsics"
        )
    try:
        return _parse(document)
    except ValueError as error:
        raise InputError(
            f"{path}: {error}; give an intrinsics.json of beltscape calibrate intrinsics"
        ) from error


def _parse(document: dict[str, Any]) -> Intrinsics:
    entries = document.get("cameras")
    if not is_dict(entries) or not entries:
        raise ValueError("cameras must be a table of cameras by name")
    cameras = {name: parse_camera(name, f"cameras.{name}", entry) for name, entry in entries.items()}
    covariances = {
        name: _parse_covariance(
            f"cameras.{name}.covariance", entry["covariance"], 4 + len(cameras[name].distortion)
        )
        for name, entry in entries.items()
        if "covariance" in entry
    }
    quality = {name: entry["quality"] for name, entry in entries.items() if is_dict(entry.get("quality"))}
    return Intrinsics(cameras, covariances, quality)


def _parse_covariance(place: str, value: Any, width: int) -> Array:
    matrix = parse_numbers(value, width, width)
    if matrix is None or not np.allclose(matrix, matrix.T):
        raise ValueError(f"{place} must be {width}×{width} numbers, symmetric")
    variance = np.diag(matrix)
    if (variance < 0).any() or not _is_positive_definite(matrix[np.ix_(variance > 0, variance > 0)]):
        raise ValueError(f"{place} is no covariance: it must be positive definite where it is not 0")
    return matrix


def _is_positive_definite(matrix: Array) -> bool:
    scale = 1 / np.sqrt(np.diag(matrix))  # parameters differ in size by orders of magnitude
    return bool(np.linalg.eigvalsh(matrix * scale[:, None] * scale).min(initial=1.0) > 0)
