"""caliscope's camera array, camera_array.toml (also config.toml of older versions): cameras in a world frame.

Read only. Each table ``cameras.N`` has ``size``, ``matrix``, ``distortions`` (OpenCV's 5, or 4 of the fisheye where
``fisheye = true``), and ``rotation`` (3, 3, or a rotation vector) and ``translation`` in metres, where x_camera =
R x_world + t. Cameras that are to be ignored or have no pose are left out of the poses.

Source: https://github.com/mprib/caliscope
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from beltscape.core.checks import is_dict, is_list
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose, rotation_from_vector
from beltscape.files.exchange import values
from beltscape.files.exchange.documents import read_document
from beltscape.files.exchange.rig_description import RigDescription


def is_of_format(document: Any) -> bool:
    """Return whether the document has tables of cameras with caliscope's keys."""
    cameras = document.get("cameras") if is_dict(document) else None
    if not is_dict(cameras) or not cameras:
        return False
    return all(is_dict(entry) and {"matrix", "distortions"} <= entry.keys() for entry in cameras.values())


def read(path: Path, warn: Callable[[str], None]) -> RigDescription:
    """Read the cameras; they are named ``cam_N`` as caliscope names their videos."""
    document = read_document(path)
    if is_dict(document) and "cameras" not in document and any(map(_is_anipose, document.values())):
        raise ValueError(
            "is a calibration of anipose (cam_0, … at its top), not of caliscope; give caliscope's camera_array.toml"
        )
    if not is_dict(document):
        raise ValueError("is no table of cameras; give a camera_array.toml of caliscope")
    cameras_by_key = values.require_value(document, "cameras")
    if not is_dict(cameras_by_key):
        raise ValueError("cameras must be a table of tables, such as [cameras.0]")
    entries = {
        f"cam_{key}": entry
        for key, entry in cameras_by_key.items()
        if not (is_dict(entry) and entry.get("ignore"))
    }
    if not entries:
        raise ValueError("ignores all of its cameras" if cameras_by_key else "has no camera")
    cameras = {name: _read_camera(name, entry) for name, entry in entries.items()}
    poses = {
        name: _read_pose(name, entry, warn)
        for name, entry in entries.items()
        if entry.get("rotation") is not None
    }
    return RigDescription(cameras, poses, next(iter(cameras)))


def _is_anipose(entry: Any) -> bool:
    """Return whether a table is a camera of aniposelib's calibration.toml."""
    return is_dict(entry) and {"matrix", "distortions"} <= entry.keys()


def _read_camera(name: str, entry: Any) -> Camera:
    if is_dict(entry) and entry.get("matrix") is None:
        raise ValueError(f"{name} has no matrix: calibrate it in caliscope, or set ignore = true")
    matrix = values.require_numbers(values.require_value(entry, "matrix", name), f"{name}.matrix", 3, 3)
    focal, center = values.split_camera_matrix(matrix, f"{name}.matrix")
    where = f"{name}.distortions"
    coefficients = values.require_numbers(values.require_value(entry, "distortions", name), where, -1)
    model, lens = values.require_lens(coefficients, where, is_fisheye=bool(entry.get("fisheye")))
    return values.make_camera(
        name, name, values.require_value(entry, "size", name), focal, center, lens, model
    )


def _read_pose(name: str, entry: dict[str, Any], warn: Callable[[str], None]) -> Pose:
    where, given = f"{name}.rotation", entry["rotation"]
    if is_list(given) and len(given) == 3 and not any(map(is_list, given)):
        rotation = rotation_from_vector(values.require_numbers(given, where, 3))
    else:
        rotation = values.require_numbers(given, where, 3, 3)
    translation = values.require_numbers(
        values.require_value(entry, "translation", name), f"{name}.translation", 3
    )
    return values.make_pose(where, rotation, translation * values.MM_PER_M, warn)
