"""Reading and writing of rig.json, a calibrated rig (``beltscape-rig/1``)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.checks import is_dict, is_list
from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.lens import BROWN, MODELS
from beltscape.core.geometry.pose import Pose, is_rotation
from beltscape.core.geometry.rig import Rig
from beltscape.files.json_text import parse_numbers, read_json, write_json
from beltscape.files.output_folder import require_finished
from beltscape.files.paths import AnyPath, as_path
from beltscape.files.rig_limits import find_refusal

FORMAT = "beltscape-rig/1"
_IDENTITY = 1e-6
"""Largest difference of the core camera's pose, in mm and of its rotation, from the identity; for other writers."""


def write_rig(path: AnyPath, rig: Rig) -> None:
    """Write a rig, atomically, with full float precision."""
    path = as_path(path)
    write_json(path, rig_document(rig))


def rig_document(rig: Rig) -> dict[str, Any]:
    """Return the document of rig.json."""
    return {
        "format": FORMAT,
        "core": rig.core,
        "units": "mm",
        "cameras": {
            name: {
                "size_px": list(camera.size_px),
                "focal_px": camera.focal_px,
                "center_px": camera.center_px,
                **describe_lens(camera),
                "cam_from_core": {
                    "rotation": rig.cam_from_core[name].rotation,
                    "translation_mm": rig.cam_from_core[name].translation_mm,
                },
            }
            for name, camera in rig.cameras.items()
        },
        "quality": rig.quality,
        "covariance": rig.covariance,
    }


def describe_lens(camera: Camera) -> dict[str, Any]:
    """Return the keys of a lens; Brown's model, which a file means that names none, is not named."""
    return {
        **({} if camera.model == BROWN.name else {"model": camera.model}),
        "distortion": camera.distortion,
        **({} if camera.valid_radius_px is None else {"valid_radius_px": camera.valid_radius_px}),
    }


def read_rig(path: AnyPath) -> Rig:
    """Read rig.json; InputError with the first invalid key."""
    path = as_path(path)
    require_finished(path.parent)
    document = read_json(path)
    format_ = document.get("format") if is_dict(document) else None
    if format_ != FORMAT:
        raise InputError(
            f"{path}: format is {format_!r}, not {FORMAT!r}; give a rig.json of beltscape calibrate"
        )
    try:
        return _rig(document)
    except ValueError as error:
        raise InputError(f"{path}: {error}; give a rig.json of beltscape calibrate") from error


def _rig(document: Mapping[str, Any]) -> Rig:
    """Return the rig; ValueError with a readable message if the document is invalid."""
    units = _value(document, "units")
    if units != "mm":
        raise ValueError(f'units = {units!r}: only "mm" is known')
    entries, core = _value(document, "cameras"), _value(document, "core")
    if not is_dict(entries) or not entries:
        raise ValueError("cameras must be a table of cameras by name")
    if core not in entries:
        raise ValueError(f"core = {core!r} is not among the cameras {', '.join(entries)}")
    cameras = {name: parse_camera(name, f"cameras.{name}", entry) for name, entry in entries.items()}
    poses = {
        name: _pose(f"cameras.{name}.cam_from_core", _value(entry, "cam_from_core", f"cameras.{name}"))
        for name, entry in entries.items()
    }
    at_core = np.column_stack([poses[core].rotation, poses[core].translation_mm])
    if not np.allclose(at_core, np.eye(3, 4), rtol=0, atol=_IDENTITY):
        raise ValueError(f"cam_from_core of the core camera {core} must be the identity")
    rig = Rig(
        core=core,
        cameras=cameras,
        cam_from_core=poses,
        quality=_table(document, "quality"),
        covariance=_covariance(_table(document, "covariance")),
    )
    refusal = find_refusal(rig)
    if refusal is not None:
        raise ValueError(refusal)
    return rig


def _table(document: Mapping[str, Any], key: str) -> dict[str, Any]:
    """Return a table that may be absent."""
    table: Any = document.get(key)
    if table and not is_dict(table):
        raise ValueError(f"{key} must be a table")
    return table or {}


def _covariance(table: dict[str, Any]) -> dict[str, Any]:
    """Return the covariance; ValueError unless its matrix has a row and a column for each of its parameters."""
    names = table.get("parameters", [])
    if not is_list(names) or not all(isinstance(name, str) for name in names):
        raise ValueError("covariance.parameters must be a list of names")
    if table and parse_numbers(table.get("matrix", []), *(len(names),) * (2 if names else 1)) is None:
        raise ValueError(
            f"covariance.matrix must be {len(names)}×{len(names)} numbers, as its parameters are"
        )
    return table


def parse_camera(name: str, place: str, entry: Any) -> Camera:
    """Return the intrinsics of an entry of a document at ``place``; ValueError with the first invalid key."""
    size = _numbers(place, entry, "size_px", (2,))
    focal = _numbers(place, entry, "focal_px", (2,))
    if size.min() < 1 or (size % 1).any():
        raise ValueError(f"{place}.size_px = {entry['size_px']}: must be two positive whole numbers")
    if focal.min() <= 0:
        raise ValueError(f"{place}.focal_px = {entry['focal_px']}: must be positive")
    model, radius = entry.get("model", BROWN.name), entry.get("valid_radius_px")
    if model not in MODELS:
        raise ValueError(f"{place}.model = {model!r}: must be one of {', '.join(MODELS)}")
    if radius is not None and _numbers(place, entry, "valid_radius_px", ()) <= 0:
        raise ValueError(f"{place}.valid_radius_px = {radius}: must be positive")
    return Camera(
        name=name,
        size_px=(int(size[0]), int(size[1])),
        focal_px=focal,
        center_px=_numbers(place, entry, "center_px", (2,)),
        distortion=_distortion(place, entry, model),
        model=model,
        valid_radius_px=None if radius is None else float(radius),
    )


def _distortion(place: str, entry: Any, model: str) -> NDArray[np.float64]:
    """Return the coefficients of a lens model; ValueError with their names if their number is another."""
    names = MODELS[model].coefficients
    value = _value(entry, "distortion", place)
    if is_list(value) and len(value) != len(names):
        fits = [other.name for other in MODELS.values() if len(other.coefficients) == len(value)]
        raise ValueError(
            f"{place}.distortion has {len(value)} numbers, model {model} takes {len(names)}: {', '.join(names)}"
            + (f'; {len(value)} are those of "model": "{fits[0]}"' if fits else "")
        )
    return _numbers(place, entry, "distortion", (len(names),))


def _pose(place: str, entry: Any) -> Pose:
    rotation = _numbers(place, entry, "rotation", (3, 3))
    if not is_rotation(rotation):
        raise ValueError(f"{place}.rotation is not a rotation (orthonormal, determinant +1)")
    return Pose(rotation, _numbers(place, entry, "translation_mm", (3,)))


def _numbers(place: str, entry: Any, key: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    numbers = parse_numbers(_value(entry, key, place), *shape)
    if numbers is None:
        raise ValueError(
            f"{place}.{key} must be {'×'.join(map(str, shape)) + ' numbers' if shape else 'a number'}"
        )
    return numbers


def _value(entry: Any, key: str, place: str = "") -> Any:
    if not is_dict(entry):
        raise ValueError(f"{place} must be a table")
    if key not in entry:
        raise ValueError(f"{place}.{key} is missing".removeprefix("."))
    return entry[key]
