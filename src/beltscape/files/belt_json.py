"""Reading and writing of belt.json, the learned model of an empty belt (``beltscape-belt/1``)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast, get_args

import numpy as np
from numpy.typing import NDArray

from beltscape.core.checks import is_dict, is_list
from beltscape.core.empty_belt import Belt, BeltDeviation, BeltEdges, End
from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose, is_rotation
from beltscape.files.atomic import write_text
from beltscape.files.json_text import add_digest, parse_numbers, read_json, require_digest, to_json
from beltscape.files.paths import AnyPath, as_path

FORMAT = "beltscape-belt/1"
_FIX = "give a belt.json of beltscape measure belt"
_NUMBERS = ("flat_rms_mm", "noise_mm", "correlation_px", "drift_mm", "tilt_sigma_rad", "claimed_sigma_mm")
_EDGES = ("left_mm", "right_mm", "left_sigma_mm", "right_sigma_mm", "offset_mm", "sigma_mm")


def write_belt(
    path: AnyPath, belt: Belt, camera: Camera, zero_settings: Sequence[Mapping[str, Any]] = ()
) -> None:
    """Write a belt and its core camera, atomically, with full float precision.

    ``zero_settings`` are the corrections of its zero since it was learned, oldest first.
    """
    write_text(as_path(path), format_belt(belt, camera, zero_settings))


def format_belt(belt: Belt, camera: Camera, zero_settings: Sequence[Mapping[str, Any]] = ()) -> str:
    """Return the text of belt.json; see `write_belt`."""
    settings = {"zero_settings": list(zero_settings)} if zero_settings else {}
    return to_json(add_digest({**belt_document(belt, camera), **settings}))


def read_zero_settings(path: AnyPath) -> list[dict[str, Any]]:
    """Return the corrections of the zero of a belt.json since it was learned, oldest first."""
    document = read_json(as_path(path))
    entries = document.get("zero_settings") if is_dict(document) else None
    return [dict(entry) for entry in entries if is_dict(entry)] if is_list(entries) else []


def belt_document(belt: Belt, camera: Camera) -> dict[str, Any]:
    """Return the document of belt.json; null stands for what was not measured."""
    edges, deviation = belt.edges, belt.deviation
    return {
        "format": FORMAT,
        "units": "mm",
        "frames": belt.frames,
        "core": {
            "name": camera.name,
            "size_px": list(camera.size_px),
            "focal_px": camera.focal_px,
            "center_px": camera.center_px,
        },
        "belt_from_core": {
            "rotation": belt.belt_from_core.rotation,
            "translation_mm": belt.belt_from_core.translation_mm,
        },
        "section": {"x_mm": belt.x_mm, "z_mm": belt.z_mm, "sigma_mm": belt.z_sigma_mm},
        "across_mm": belt.across_mm,
        "along_mm": belt.along_mm,
        "flat_mm": belt.flat_mm,
        "ends": None if belt.ends is None else list(belt.ends),
        "clear_mm": [x if np.isfinite(x) else None for x in belt.clear_mm],
        "width_mm": belt.width_mm,
        "deviation": deviation
        and {
            "x_mm": deviation.x_mm,
            "y_mm": deviation.y_mm,
            "height_mm": deviation.height_mm,
            "sigma_mm": deviation.sigma_mm,
        },
        "edges": edges and {**{key: getattr(edges, key) for key in _EDGES}, "against": edges.against},
        "quality": {
            **{key: getattr(belt, key) for key in _NUMBERS},
            "yaw_sigma_rad": belt.yaw_sigma_rad,
            "yaw_from": belt.yaw_from,
        },
    }


def read_belt(path: AnyPath) -> tuple[Belt, Camera]:
    """Read belt.json; InputError with the first invalid key, or if it was changed. The camera has no distortion."""
    path = as_path(path)
    document = read_json(path)
    format_ = document.get("format") if is_dict(document) else None
    if format_ != FORMAT:
        raise InputError(f"{path}: format is {format_!r}, not {FORMAT!r}; {_FIX}")
    try:
        belt, camera = _belt(document), _camera(_entry(document, "core"))
    except ValueError as error:
        raise InputError(f"{path}: {error}; {_FIX}") from error
    require_digest(path, document, _FIX)
    return replace(belt, camera=camera), camera


def _belt(document: Mapping[str, Any]) -> Belt:
    """Return the belt; ValueError with a readable message if the document is invalid."""
    if document.get("units") != "mm":
        raise ValueError(f'units = {document.get("units")!r}: only "mm" is known')
    frames = document.get("frames")
    if not isinstance(frames, int) or isinstance(frames, bool) or frames < 1:
        raise ValueError(f"frames = {frames!r}: must be a whole number of at least 1")
    section, quality = _entry(document, "section"), _entry(document, "quality")
    x = _require_ascending("section", section, "x_mm")
    yaw_from = quality.get("yaw_from")
    if yaw_from not in ("shape", "edges", "told", "camera"):
        raise ValueError(f"quality.yaw_from = {yaw_from!r}: must be shape, edges, told or camera")
    yaw = quality.get("yaw_sigma_rad")
    flat = document.get("flat_mm")
    numbers: dict[str, Any] = {key: _number("quality", quality, key) for key in _NUMBERS}
    return Belt(
        belt_from_core=_pose(_entry(document, "belt_from_core")),
        x_mm=x,
        z_mm=_array("section", section, "z_mm", x.shape),
        across_mm=_range(document, "across_mm"),
        flat_mm=None if flat is None else _range(document, "flat_mm"),
        yaw_sigma_rad=None if yaw is None else _number("quality", quality, "yaw_sigma_rad"),
        yaw_from=yaw_from,
        z_sigma_mm=_array("section", section, "sigma_mm", x.shape),
        along_mm=_range(document, "along_mm"),
        deviation=None if document.get("deviation") is None else _deviation(_entry(document, "deviation")),
        edges=None if document.get("edges") is None else _edges(_entry(document, "edges")),
        frames=frames,
        ends=_ends(document.get("ends")),
        clear_mm=_clear(document),
        width_mm=None if document.get("width_mm") is None else _number("", document, "width_mm"),
        **numbers,
    )


def _ends(value: object) -> tuple[End, End] | None:
    """Return what is known of the ends; None in files of earlier versions."""
    if value is None:
        return None
    known = get_args(End)
    if not is_list(value) or len(value) != 2 or any(end not in known for end in value):
        raise ValueError(f"ends = {value!r}: must be two of {', '.join(known)}")
    return cast("tuple[End, End]", tuple(value))


def _clear(document: Mapping[str, Any]) -> tuple[float, float]:
    """Return the range clear of things beside the belt; null, or a missing key, is a side without any."""
    value = document.get("clear_mm", [None, None])
    pair: list[object] = value if is_list(value) and len(value) == 2 else ["", ""]
    filled = [limit if own is None else own for own, limit in zip(pair, (-1e9, 1e9), strict=True)]
    low, high = _array("", {"clear_mm": filled}, "clear_mm", (2,))
    return float(low) if low > -1e9 else -np.inf, float(high) if high < 1e9 else np.inf


def _deviation(entry: Mapping[str, Any]) -> BeltDeviation:
    x, y = (_require_ascending("deviation", entry, key) for key in ("x_mm", "y_mm"))
    shape = (len(y), len(x))
    return BeltDeviation(
        x, y, _array("deviation", entry, "height_mm", shape), _array("deviation", entry, "sigma_mm", shape)
    )


def _edges(entry: Mapping[str, Any]) -> BeltEdges:
    against = entry.get("against")
    if against not in ("trough", "learned"):
        raise ValueError(f"edges.against = {against!r}: must be trough or learned")
    numbers = {key: np.nan if entry.get(key) is None else _number("edges", entry, key) for key in _EDGES}
    return BeltEdges(**numbers, against=against)


def _camera(entry: Mapping[str, Any]) -> Camera:
    size = _array("core", entry, "size_px", (2,))
    if size.min() < 1 or (size % 1).any():
        raise ValueError(f"core.size_px = {entry['size_px']}: must be two positive whole numbers")
    return Camera(
        str(entry.get("name")),
        (int(size[0]), int(size[1])),
        _array("core", entry, "focal_px", (2,)),
        _array("core", entry, "center_px", (2,)),
        np.zeros(5),
    )


def _pose(entry: Mapping[str, Any]) -> Pose:
    rotation = _array("belt_from_core", entry, "rotation", (3, 3))
    if not is_rotation(rotation):
        raise ValueError("belt_from_core.rotation is not a rotation (orthonormal, determinant +1)")
    return Pose(rotation, _array("belt_from_core", entry, "translation_mm", (3,)))


def _entry(document: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = document.get(key)
    if not is_dict(value):
        raise ValueError(f"{key} must be a table")
    return value


def _range(document: Mapping[str, Any], key: str) -> tuple[float, float]:
    low, high = _array("", document, key, (2,))
    if low >= high:
        raise ValueError(f"{key} = {document[key]}: the first number must be the smaller one")
    return float(low), float(high)


def _require_ascending(place: str, entry: Mapping[str, Any], key: str) -> NDArray[np.float64]:
    value = entry.get(key)
    values = _array(place, entry, key, (len(value) if is_list(value) else 0,))
    if len(values) < 2 or (np.diff(values) <= 0).any():
        raise ValueError(f"{place}.{key} must be two or more ascending numbers")
    return values


def _number(place: str, entry: Mapping[str, Any], key: str) -> float:
    return float(_array(place, entry, key, ()))


def _array(place: str, entry: Mapping[str, Any], key: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    values = parse_numbers(entry.get(key), *shape)
    if values is None:
        size = "×".join(map(str, shape)) + " numbers" if shape else "a number"
        raise ValueError(f"{place}.{key} must be {size}".replace(" .", " ").removeprefix("."))
    return values
