"""OpenCV FileStorage YAML.

Written: one file with ``core``, ``units`` and the list ``cameras``; each has ``name`` and what OpenCV's calibration
sample writes (``image_width``, ``image_height``, ``camera_matrix``, ``distortion_coefficients`` of 5, 8, 12 or 14
numbers, or ``fisheye_model`` 1 and 4 of `cv2.fisheye`), and ``R``, ``T`` as `cv2.stereoCalibrate` gives them with the
core as its first camera: x_cam = R x_core + T, T in mm. Nothing is lost but quality and covariance.

Read: that, or one camera's file of OpenCV's sample (also with its older capital letters), or a folder of these,
whose cameras are named by file and have no poses. Pixel (0, 0) is the centre of the top-left pixel, as in
Beltscape.

Source: https://docs.opencv.org/4.x/d4/d94/tutorial_camera_calibration.html
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
from beltscape.files.exchange.documents import (
    Matrix,
    Quoted,
    read_document,
    to_floats,
    write_yaml,
    yaml_files,
)
from beltscape.files.exchange.rig_description import RigDescription


def is_of_format(document: Any) -> bool:
    """Return whether the document is a list of cameras, or one camera without the keys of ROS."""
    if not is_dict(document):
        return False
    keys = {str(key).lower() for key in document}
    ros = {"camera_name", "distortion_model", "projection_matrix"}
    return is_list(document.get("cameras")) or ("camera_matrix" in keys and not keys & ros)


def write(path: Path, rig: Rig, warn: Callable[[str], None]) -> list[Path]:  # noqa: ARG001
    """Write the rig as one file that `cv2.FileStorage` reads."""
    entries = [
        {
            "name": Quoted(name),
            "image_width": camera.size_px[0],
            "image_height": camera.size_px[1],
            "camera_matrix": _matrix(camera.matrix),
            **({"fisheye_model": 1} if camera.model == "fisheye" else {}),
            "distortion_coefficients": _matrix(camera.distortion[None]),
            "R": _matrix(rig.cam_from_core[name].rotation),
            "T": _matrix(rig.cam_from_core[name].translation_mm[:, None]),
        }
        for name, camera in rig.cameras.items()
    ]
    document = {"core": Quoted(rig.core), "units": "mm", "cameras": entries}
    write_yaml(path, document, head="%YAML 1.2\n---\n")
    return [path]


def read(path: Path, warn: Callable[[str], None]) -> RigDescription:
    """Read one file of cameras, one camera's file, or a folder of these."""
    if path.is_dir():
        cameras = {
            file.stem: _read_camera(file.stem, read_document(file), file.name) for file in yaml_files(path)
        }
        return RigDescription(cameras, {}, next(iter(cameras)))
    document = read_document(path)
    if not is_dict(document) or "cameras" not in document:
        return RigDescription({path.stem: _read_camera(path.stem, document, path.stem)}, {}, path.stem)
    entries = document["cameras"]
    if not is_list(entries) or not entries:
        raise ValueError("cameras must be a list of cameras")
    names = [str(values.require_value(entry, "name", f"cameras[{i}]")) for i, entry in enumerate(entries)]
    named = dict(zip(values.require_distinct(names), entries, strict=True))
    return RigDescription(
        {name: _read_camera(name, entry, f"cameras.{name}") for name, entry in named.items()},
        {name: _pose(document, name, entry, warn) for name, entry in named.items() if "R" in entry},
        str(document.get("core") or names[0]),
    )


def _read_camera(name: str, document: Any, place: str) -> Camera:
    if not is_dict(document):
        raise ValueError(f"{place} must be a table with camera_matrix and distortion_coefficients")
    entry = {str(key).lower(): item for key, item in document.items()}
    model = "fisheye" if entry.get("fisheye_model") else entry.get("distortion_model", "plumb_bob")
    known = ("plumb_bob", "rational_polynomial", "fisheye", "equidistant")
    values.require_known(model, f"{place}.distortion_model", known, "calibrate with cv2.calibrateCamera")
    return values.require_camera(name, entry, place, is_fisheye=model in ("fisheye", "equidistant"))


def _pose(document: dict[str, Any], name: str, entry: Any, warn: Callable[[str], None]) -> Pose:
    place = f"cameras.{name}"
    rotation = values.require_matrix(values.require_value(entry, "R", place), f"{place}.R", 3, 3)
    translation = values.require_translation(entry, "T", place)
    return values.make_pose(f"{place}.R", rotation, translation * values.require_unit(document), warn)


def _matrix(array: np.ndarray) -> Matrix:
    rows, cols = array.shape
    return Matrix(rows=rows, cols=cols, dt="d", data=to_floats(array.ravel()))
