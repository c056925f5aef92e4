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

import numpy as np

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose, rotation_from_vector
from beltscape.core.type_guards import is_dict
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
    entries = {
        f"cam_{key}": entry
        for key, entry in read_document(path)["cameras"].items()
        if not entry.get("ignore")
    }
    if not entries:
        raise ValueError("ignores all of its cameras")
    cameras = {name: _read_camera(name, entry) for name, entry in entries.items()}
    poses = {
        name: _read_pose(name, entry, warn)
        for name, entry in entries.items()
        if entry.get("rotation") is not None
    }
    return RigDescription(cameras, poses, next(iter(cameras)))


def _read_camera(name: str, entry: dict[str, Any]) -> Camera:
    matrix = values.require_numbers(entry["matrix"], f"{name}.matrix", 3, 3)
    focal, center = values.split_camera_matrix(matrix, f"{name}.matrix")
    where = f"{name}.distortions"
    coefficients = values.require_numbers(entry["distortions"], where, -1)
    model, lens = values.require_lens(coefficients, where, is_fisheye=bool(entry.get("fisheye")))
    return values.make_camera(
        name, name, values.require_value(entry, "size", name), focal, center, lens, model
    )


def _read_pose(name: str, entry: dict[str, Any], warn: Callable[[str], None]) -> Pose:
    given = np.asarray(entry["rotation"], dtype=np.float64)
    rotation = rotation_from_vector(given) if given.shape == (3,) else given
    rotation = values.require_numbers(rotation, f"{name}.rotation", 3, 3)
    translation = values.require_numbers(
        values.require_value(entry, "translation", name), f"{name}.translation", 3
    )
    return values.make_pose(f"{name}.rotation", rotation, translation * values.MM_PER_M, warn)
