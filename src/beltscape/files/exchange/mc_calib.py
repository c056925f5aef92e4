"""MC-Calib's calibrated_cameras_data.yml: any number of cameras.

Read only. ``camera_pose_matrix`` (4, 4) is the pose of the camera in the frame of the first one, so that
x_reference = M x_camera; ``distortion_type`` 0 is OpenCV's polynomial and 1 its fisheye. The file does not state the
unit of its translations, which is that of the board's squares: add ``units: mm`` (or cm, m).

References
----------
F. Rameau, J. Park, O. Bailo, I. S. Kweon, MC-Calib: A generic and robust calibration toolbox for multi-camera
systems, CVIU 217, 2022, doi:10.1016/j.cviu.2021.103353.
The direction of the pose: github.com/rameau-fr/MC-Calib, issue 56.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.checks import is_dict
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.files.exchange import values
from beltscape.files.exchange.documents import read_document
from beltscape.files.exchange.rig_description import RigDescription

_MODELS = {0: "brown", 1: "fisheye"}
"""Its distortion_type → lens model."""


def is_of_format(document: Any) -> bool:
    """Return whether the document has the key of MC-Calib's number of cameras."""
    return is_dict(document) and "nb_camera" in document


def read(path: Path, warn: Callable[[str], None]) -> RigDescription:
    """Read the file's cameras in their order."""
    document = read_document(path)
    unit = values.require_unit(document)
    entries = {str(key): item for key, item in document.items() if str(key).startswith("camera_")}
    if not entries:
        raise ValueError("has no camera_0")
    cameras = {name: _read_camera(name, entry) for name, entry in entries.items()}
    poses = {name: _read_pose(name, entry, unit, warn) for name, entry in entries.items()}
    return RigDescription(cameras, poses, next(iter(cameras)))


def _read_camera(name: str, entry: Any) -> Camera:
    kind = int(values.require_numbers(values.require_value(entry, "distortion_type", name), name))
    if kind not in _MODELS:
        raise ValueError(f"{name}.distortion_type = {kind}: must be 0 or 1")
    matrix = values.require_matrix(
        values.require_value(entry, "camera_matrix", name), f"{name}.camera_matrix", 3, 3
    )
    focal, center = values.split_camera_matrix(matrix, f"{name}.camera_matrix")
    where = f"{name}.distortion_vector"
    vector = values.require_matrix(values.require_value(entry, "distortion_vector", name), where, -1)
    size = [values.require_value(entry, key, name) for key in ("img_width", "img_height")]
    is_fisheye = _MODELS[kind] == "fisheye"
    model, lens = values.require_lens(vector[:4] if is_fisheye else vector, where, is_fisheye=is_fisheye)
    return values.make_camera(name, name, size, focal, center, lens, model)


def _read_pose(name: str, entry: Any, unit: float, warn: Callable[[str], None]) -> Pose:
    place = f"{name}.camera_pose_matrix"
    matrix = values.require_matrix(values.require_value(entry, "camera_pose_matrix", name), place, 4, 4)
    if not np.allclose(matrix[3], [0, 0, 0, 1]):
        raise ValueError(f"{place}: its last row must be 0 0 0 1")
    return values.make_pose(place, matrix[:3, :3], matrix[:3, 3] * unit, warn).inverse()
