"""rig.json: ``beltscape-rig/1``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.camera import Camera
from beltscape.core.errors import InputError
from beltscape.core.pose import Pose
from beltscape.core.rig import Rig
from beltscape.files.json_text import read_json, write_json

FORMAT = "beltscape-rig/1"


def write_rig(path: Path, rig: Rig) -> None:
    """Write a rig, atomically, with full float precision."""
    write_json(path, rig_document(rig))


def rig_document(rig: Rig) -> dict[str, Any]:
    """The rig as the plain document that rig.json holds."""
    return {
        "format": FORMAT,
        "core": rig.core,
        "units": "mm",
        "cameras": {
            name: {
                "size_px": list(camera.size_px),
                "focal_px": camera.focal_px,
                "center_px": camera.center_px,
                "distortion": camera.distortion,
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


def read_rig(path: Path) -> Rig:
    """Read rig.json, or InputError naming the key that does not fit."""
    document = read_json(path)
    found = document.get("format") if isinstance(document, dict) else None
    if found != FORMAT:
        raise InputError(
            f"{path}: format is {found!r}, not {FORMAT!r}; give a rig.json of beltscape calibrate"
        )
    try:
        return _rig(path, document)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        what = f"key {error} is missing" if isinstance(error, KeyError) else str(error)
        raise InputError(f"{path}: not a complete rig ({what})") from error


def _rig(path: Path, document: Mapping[str, Any]) -> Rig:
    if document.get("units") != "mm":
        raise InputError(f'{path}: units are {document.get("units")!r}; only "mm" is known')
    entries = document["cameras"]
    core = document["core"]
    if core not in entries:
        raise InputError(f"{path}: core camera {core!r} is not among the cameras {', '.join(entries)}")
    poses = {name: _pose(path, name, entry["cam_from_core"]) for name, entry in entries.items()}
    if not np.allclose(poses[core].rotation, np.eye(3), atol=1e-6) or np.any(
        np.abs(poses[core].translation_mm) > 1e-6
    ):
        raise InputError(f"{path}: cam_from_core of the core camera {core!r} must be the identity")
    return Rig(
        core=core,
        cameras={name: _camera(name, entry) for name, entry in entries.items()},
        cam_from_core=poses,
        quality=document.get("quality") or {},
        covariance=document.get("covariance") or {},
    )


def _camera(name: str, entry: Mapping[str, Any]) -> Camera:
    width, height = (int(n) for n in entry["size_px"])
    camera = Camera(
        name=name,
        size_px=(width, height),
        focal_px=_vector(name, "focal_px", entry["focal_px"], 2),
        center_px=_vector(name, "center_px", entry["center_px"], 2),
        distortion=_vector(name, "distortion", entry["distortion"], 5),
    )
    if min(camera.size_px) <= 0 or camera.focal_px.min() <= 0:
        raise ValueError(f"{name}: size_px and focal_px must be positive")
    return camera


def _vector(name: str, key: str, value: Any, size: int) -> np.ndarray:
    vector = np.asarray(value, dtype=np.float64)
    if vector.shape != (size,) or not np.isfinite(vector).all():
        raise ValueError(f"{name}: {key} must be {size} numbers, not {value}")
    return vector


def _pose(path: Path, name: str, entry: Mapping[str, Any]) -> Pose:
    rotation = np.asarray(entry["rotation"], dtype=np.float64)
    if rotation.shape != (3, 3) or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6):
        raise InputError(f"{path}: rotation of {name} is not an orthonormal 3×3 matrix")
    return Pose(rotation, _vector(name, "translation_mm", entry["translation_mm"], 3))
