"""COLMAP's rig configuration ``rig_config.json``, the input of ``colmap rig_configurator``.

One rig; each camera has ``image_prefix`` (``<name>/``, the folder of its images, which is a Beltscape capture's
layout), ``camera_model_name`` and ``camera_params``: OPENCV [fx, fy, cx, cy, k1, k2, p1, p2], or FULL_OPENCV with
k3, k4, k5, k6, or OPENCV_FISHEYE [fx, fy, cx, cy, k1, k2, k3, k4]. The core has ``ref_sensor`` true and stands
first; the others have ``cam_from_rig_rotation`` (quaternion w, x, y, z) and ``cam_from_rig_translation`` (metres):
x_cam = R x_core + t.
COLMAP's pixel (0, 0) is the *corner* of the top-left pixel, so that its cx, cy are larger by 0.5 than Beltscape's.

COLMAP keeps image sizes in its database, not here; ``width`` and ``height`` are written beside its own keys, which
it ignores, and are needed to read a file back. Lost: quality and covariance, and the order of the cameras where the
core is not the first.

Source: https://colmap.github.io/rigs.html, scene/rig.cc (ReadRigConfig), https://colmap.github.io/cameras.html,
https://colmap.github.io/database.html (pixel convention)
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.checks import is_dict, is_list
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.exchange import values
from beltscape.files.exchange.rig_description import RigDescription, names_core_first
from beltscape.files.exchange.values import rotation_from_wxyz, wxyz_from_rotation
from beltscape.files.json_text import read_json, write_json

CORNER_TO_CENTRE_PX = 0.5
"""COLMAP's (0, 0) is the corner of the first pixel, the program's its centre (COLMAP's documentation, cameras)."""

FX, FY, CX, CY = 0, 1, 2, 3
"""Indices of the parameters of the models with two focal lengths."""
LAYOUTS: dict[str, tuple[list[int], list[int]]] = {
    "SIMPLE_PINHOLE": ([0, 0, 1, 2], []),
    "PINHOLE": ([0, 1, 2, 3], []),
    "SIMPLE_RADIAL": ([0, 0, 1, 2], [0]),
    "RADIAL": ([0, 0, 1, 2], [0, 1]),
    "OPENCV": ([0, 1, 2, 3], [0, 1, 2, 3]),
    "FULL_OPENCV": ([0, 1, 2, 3], [0, 1, 2, 3, 4, 5, 6, 7]),
    "OPENCV_FISHEYE": ([0, 1, 2, 3], [0, 1, 2, 3]),
    "SIMPLE_RADIAL_FISHEYE": ([0, 0, 1, 2], [0]),
    "RADIAL_FISHEYE": ([0, 0, 1, 2], [0, 1]),
}
"""Model → indices of fx, fy, cx, cy among its parameters, and the indices of OpenCV's coefficients after them."""


def is_of_format(document: Any) -> bool:
    """Return whether the document is a list of rigs."""
    return is_list(document) and any(is_dict(rig) and "cameras" in rig for rig in document)


def write(path: Path, rig: Rig, warn: Callable[[str], None]) -> list[Path]:  # noqa: ARG001
    """Write the rig as the only one of a rig configuration."""
    entries: list[dict[str, Any]] = []
    for name in names_core_first(rig):
        camera, pose = rig.cameras[name], rig.cam_from_core[name]
        placed = {
            "cam_from_rig_rotation": wxyz_from_rotation(pose.rotation),
            "cam_from_rig_translation": pose.translation_mm / values.MM_PER_M,
        }
        entries.append(
            {
                "image_prefix": f"{name}/",
                **({"ref_sensor": True} if name == rig.core else placed),
                **_intrinsics(camera),
                "width": camera.size_px[0],
                "height": camera.size_px[1],
            }
        )
    write_json(path, [{"cameras": entries}])
    return [path]


def read(path: Path, warn: Callable[[str], None]) -> RigDescription:
    """Read the one rig of a rig configuration; its reference is the camera with ``ref_sensor``."""
    document = read_json(path)
    if not is_of_format(document):
        raise ValueError("is not a list of rigs with cameras; give a rig_config.json of COLMAP")
    if len(document) != 1:
        raise ValueError(f"holds {len(document)} rigs; keep the one to be read")
    entries = values.require_value(document[0], "cameras", "the rig")
    if not is_list(entries) or not entries:
        raise ValueError("cameras must be a list of cameras")
    named = dict(zip(_names(entries), entries, strict=True))
    reference = [name for name, entry in named.items() if entry.get("ref_sensor")]
    if len(reference) != 1:
        raise ValueError(f"{len(reference)} cameras have ref_sensor true: must be one")
    poses = {name: _pose(name, entry, warn) for name, entry in named.items() if _is_placed(entry)}
    return RigDescription(
        {name: _camera(name, entry) for name, entry in named.items()},
        {**poses, reference[0]: Pose.identity()},
        reference[0],
    )


def _intrinsics(camera: Camera) -> dict[str, Any]:
    values.require_writable(camera, "COLMAP", ("brown", "rational", "fisheye"))
    params = [*camera.focal_px, *(camera.center_px + CORNER_TO_CENTRE_PX), *camera.distortion[:4]]
    if camera.model == "fisheye":
        return {"camera_model_name": "OPENCV_FISHEYE", "camera_params": params}
    if camera.model == "brown" and camera.distortion[4] == 0:
        return {"camera_model_name": "OPENCV", "camera_params": params}
    rest = np.concatenate([camera.distortion[4:], np.zeros(8 - len(camera.distortion))])
    return {"camera_model_name": "FULL_OPENCV", "camera_params": [*params, *rest]}


def _names(entries: list[Any]) -> list[str]:
    """Return the cameras' names: the last folder of the prefix, or the whole prefix if that is not unique."""
    prefixes = [
        str(values.require_value(entry, "image_prefix", f"cameras[{i}]")).strip("/") or f"cam{i}"
        for i, entry in enumerate(entries)
    ]
    last = [prefix.rsplit("/", 1)[-1] for prefix in prefixes]
    if len(set(last)) == len(last):
        return last
    return values.require_distinct([prefix.replace("/", "_") for prefix in prefixes])


def _camera(name: str, entry: Any) -> Camera:
    fix = "let COLMAP use OPENCV, FULL_OPENCV or OPENCV_FISHEYE"
    model = values.require_value(entry, "camera_model_name", name)
    intrinsic, distorting = LAYOUTS[
        values.require_known(model, f"{name}.camera_model_name", tuple(LAYOUTS), fix)
    ]
    count = max(intrinsic) + 1 + len(distorting)
    params = values.require_numbers(
        values.require_value(entry, "camera_params", name), f"{name}.camera_params", count
    )
    coefficients = np.zeros(8)
    coefficients[distorting] = params[max(intrinsic) + 1 :]
    if "width" not in entry or "height" not in entry:
        raise ValueError(
            f'{name}: COLMAP keeps image sizes in its database; add "width" and "height" beside camera_params'
        )
    pinhole, place = params[intrinsic], f"{name}.camera_params"
    lens, coefficients = (
        ("fisheye", coefficients[:4])
        if str(model).endswith("FISHEYE")
        else values.require_lens(coefficients, place)
    )
    return values.make_camera(
        name,
        name,
        [entry["width"], entry["height"]],
        pinhole[[FX, FY]],
        pinhole[[CX, CY]] - CORNER_TO_CENTRE_PX,
        coefficients,
        lens,
    )


def _is_placed(entry: Any) -> bool:
    return "cam_from_rig_rotation" in entry and "cam_from_rig_translation" in entry


def _pose(name: str, entry: Any, warn: Callable[[str], None]) -> Pose:
    place = f"{name}.cam_from_rig_rotation"
    wxyz = values.require_numbers(entry["cam_from_rig_rotation"], place, 4)
    moved = values.require_numbers(entry["cam_from_rig_translation"], f"{name}.cam_from_rig_translation", 3)
    return values.make_pose(place, rotation_from_wxyz(wxyz, place), moved * values.MM_PER_M, warn)
