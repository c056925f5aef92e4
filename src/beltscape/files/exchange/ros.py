"""ROS camera_info YAML, one file per camera in a folder, and ``extrinsics.yaml`` beside them.

``<camera>.yaml`` is what camera_calibration_parsers reads: ``image_width``, ``image_height``, ``camera_name``,
``camera_matrix``, ``distortion_model`` plumb_bob with the ``distortion_coefficients`` k1, k2, p1, p2, k3,
rational_polynomial with k4, k5, k6 as well, or equidistant with k1, k2, k3, k4 of the fisheye model,
``rectification_matrix`` (the identity) and ``projection_matrix`` ([K | 0]: an undistorted single camera). Pixel (0,
0) is the centre of the top-left pixel, as in Beltscape.

camera_info does not hold poses. ``extrinsics.yaml`` is a tf2_msgs/TFMessage as ROS prints it: for each auxiliary
a transform with ``header.frame_id`` ``<core>_optical_frame``, ``child_frame_id`` ``<camera>_optical_frame`` (REP
103: x right, y down, z forward) and tf's direction, the pose of the child *in* its parent: x_core = R x_cam + t,
metres, quaternion x, y, z, w. Read: any tree of such transforms, with or without the suffix. Lost: quality,
covariance, the cameras' order.

Source: image_common/camera_calibration_parsers/src/parse_yml.cpp, https://www.ros.org/reps/rep-0103.html, rep-0104,
geometry_msgs/TransformStamped
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
from beltscape.files.atomic import ensure_output_folder
from beltscape.files.exchange import values
from beltscape.files.exchange.documents import read_document, to_floats, write_yaml, yaml_files
from beltscape.files.exchange.rig_description import RigDescription
from beltscape.files.exchange.values import rotation_from_wxyz, wxyz_from_rotation

DISTORTIONS = {"brown": "plumb_bob", "rational": "rational_polynomial", "fisheye": "equidistant"}
"""Lens models and their names in sensor_msgs/distortion_models.hpp."""
EXTRINSICS = "extrinsics.yaml"
SUFFIX = "_optical_frame"


def is_of_format(document: Any) -> bool:
    """Return whether the document is one camera with a key that OpenCV's files do not have."""
    if not is_dict(document) or "camera_matrix" not in document:
        return False
    return bool({"camera_name", "distortion_model", "projection_matrix"} & set(document))


def write(path: Path, rig: Rig, warn: Callable[[str], None]) -> list[Path]:  # noqa: ARG001
    """Write a folder with one camera_info per camera, and the poses."""
    for name in rig.cameras:
        if "/" in name or "\\" in name or name in ("", ".", "..", Path(EXTRINSICS).stem):
            raise ValueError(f"camera name {name!r} cannot name a file here; rename the camera in rig.json")
    ensure_output_folder(path)
    files: list[Path] = []
    for name, camera in rig.cameras.items():
        files.append(path / f"{name}.yaml")
        write_yaml(files[-1], _camera_info(camera))
    transforms = [_transform(rig, name) for name in rig.auxiliaries]
    write_yaml(path / EXTRINSICS, {"transforms": transforms})
    return [*files, path / EXTRINSICS]


def read(path: Path, warn: Callable[[str], None]) -> RigDescription:
    """Read a folder of camera_info files, with or without poses, or one camera's file."""
    if not path.is_dir():
        camera = _camera(path, read_document(path))
        return RigDescription({camera.name: camera}, {}, camera.name)
    files = [file for file in yaml_files(path) if file.name != EXTRINSICS]
    listed = [_camera(file, read_document(file)) for file in files]
    if not listed:
        raise ValueError(f"holds no camera_info beside {EXTRINSICS}; add one file per camera")
    values.require_distinct([camera.name for camera in listed])
    cameras = {camera.name: camera for camera in listed}
    if not (path / EXTRINSICS).exists():
        return RigDescription(cameras, {}, listed[0].name)
    root, poses = _tree(read_document(path / EXTRINSICS), warn)
    poses = {name: poses[name] for name in cameras if name in poses}
    return RigDescription(cameras, poses, root if root in cameras else listed[0].name)


def _camera_info(camera: Camera) -> dict[str, Any]:
    values.require_writable(camera, "ROS", tuple(DISTORTIONS))
    return {
        "image_width": camera.size_px[0],
        "image_height": camera.size_px[1],
        "camera_name": camera.name,
        "camera_matrix": _matrix(camera.matrix),
        "distortion_model": DISTORTIONS[camera.model],
        "distortion_coefficients": _matrix(camera.distortion[None]),
        "rectification_matrix": _matrix(np.eye(3)),
        "projection_matrix": _matrix(np.column_stack([camera.matrix, np.zeros(3)])),
    }


def _camera(file: Path, document: Any) -> Camera:
    place = file.name
    values.require_value(document, "camera_matrix", place)
    model = values.require_known(
        document.get("distortion_model", "plumb_bob"),
        f"{place}.distortion_model",
        (*DISTORTIONS.values(), "fisheye"),
        "calibrate with plumb_bob",
    )
    name = str(document.get("camera_name") or file.stem)
    return values.require_camera(name, document, place, is_fisheye=model in ("equidistant", "fisheye"))


def _transform(rig: Rig, name: str) -> dict[str, Any]:
    """Return the pose of a camera in the core's frame as a tf transform."""
    core_from_cam = rig.cam_from_core[name].inverse()
    w, x, y, z = to_floats(wxyz_from_rotation(core_from_cam.rotation))
    moved = to_floats(core_from_cam.translation_mm / values.MM_PER_M)
    return {
        "header": {"frame_id": f"{rig.core}{SUFFIX}"},
        "child_frame_id": f"{name}{SUFFIX}",
        "transform": {
            "translation": dict(zip("xyz", moved, strict=True)),
            "rotation": {"x": x, "y": y, "z": z, "w": w},
        },
    }


def _tree(document: Any, warn: Callable[[str], None]) -> tuple[str, dict[str, Pose]]:
    """Return the root's name and ``frame_from_root`` by name from a list of transforms."""
    listed = values.require_value(document, "transforms", EXTRINSICS)
    if not is_list(listed):
        raise ValueError(f"{EXTRINSICS}.transforms must be a list")
    parents: dict[str, str] = {}
    child_from_parent: dict[str, Pose] = {}
    for i, entry in enumerate(listed):
        place = f"{EXTRINSICS}.transforms[{i}]"
        child = str(values.require_value(entry, "child_frame_id", place)).removesuffix(SUFFIX)
        header = values.require_value(entry, "header", place)
        parents[child] = str(values.require_value(header, "frame_id", f"{place}.header")).removesuffix(SUFFIX)
        child_from_parent[child] = _pose(
            place, values.require_value(entry, "transform", place), warn
        ).inverse()
    roots = list(dict.fromkeys(parent for parent in parents.values() if parent not in parents))
    if len(roots) > 1 or (parents and not roots):
        raise ValueError(
            f"{EXTRINSICS} must be one tree of frames; its roots are {', '.join(roots) or 'none'}"
        )
    poses = {root: Pose.identity() for root in roots}
    while waiting := [c for c in parents if c not in poses and parents[c] in poses]:
        poses.update({child: child_from_parent[child] @ poses[parents[child]] for child in waiting})
    return (roots or [""])[0], poses


def _pose(place: str, entry: Any, warn: Callable[[str], None]) -> Pose:
    """Return parent_from_child of one transform."""
    turned, moved = (
        values.require_value(entry, "rotation", place),
        values.require_value(entry, "translation", place),
    )
    wxyz = values.require_numbers(
        [values.require_value(turned, key, f"{place}.rotation") for key in "wxyz"], f"{place}.rotation", 4
    )
    metres = [values.require_value(moved, key, f"{place}.translation") for key in "xyz"]
    translation_mm = values.require_numbers(metres, f"{place}.translation", 3) * values.MM_PER_M
    rotation = rotation_from_wxyz(wxyz, f"{place}.rotation")
    return values.make_pose(f"{place}.rotation", rotation, translation_mm, warn)


def _matrix(array: np.ndarray) -> dict[str, Any]:
    rows, cols = array.shape
    return {"rows": rows, "cols": cols, "data": to_floats(array.ravel())}
