"""The two files of OpenCV's sample stereo_calib, and what people write with `cv2.stereoCalibrate` in their manner.

Read only: a YAML file, or a folder with intrinsics.yml and extrinsics.yml, with ``M1``, ``D1``, ``M2``, ``D2``, ``R``
and ``T``: x_2 = R x_1 + T. The cameras are named ``cam1`` (the core) and ``cam2``. The sample writes neither the unit
of T, which is that of the board's squares, nor the size of the images; both must be added:
``units: mm``, ``image_width: 1280``, ``image_height: 720``.

Source: https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html, `stereoCalibrate`
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from beltscape.core.checks import is_dict
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.files.exchange import values
from beltscape.files.exchange.documents import read_document, yaml_files
from beltscape.files.exchange.rig_description import RigDescription

_NAMES = ("cam1", "cam2")


def is_of_format(document: Any) -> bool:
    """Return whether the document has the matrices of two cameras, or the transform between them."""
    if not is_dict(document):
        return False
    return {"M1", "D1"} <= document.keys() or {"R", "T", "R1", "P1"} <= document.keys()


def read(path: Path, warn: Callable[[str], None]) -> RigDescription:
    """Read a file, or a folder whose files are taken together."""
    document: dict[str, Any] = {}
    for file in yaml_files(path) if path.is_dir() else [path]:
        part = read_document(file)
        if is_dict(part):
            document |= part
    size = [values.require_value(document, key) for key in ("image_width", "image_height")]
    cameras = {name: _read_camera(document, name, number, size) for number, name in enumerate(_NAMES, 1)}
    unit = values.require_unit(document)
    rotation = values.require_matrix(values.require_value(document, "R"), "R", 3, 3)
    translation = values.require_translation(document, "T")
    pose = values.make_pose("R", rotation, translation * unit, warn)
    return RigDescription(cameras, {_NAMES[0]: Pose.identity(), _NAMES[1]: pose}, _NAMES[0])


def _read_camera(document: dict[str, Any], name: str, number: int, size: Any) -> Camera:
    place = f"M{number}"
    matrix = values.require_matrix(values.require_value(document, place), place, 3, 3)
    where = f"D{number}"
    coefficients = values.require_matrix(values.require_value(document, where), where, -1)
    focal, center = values.split_camera_matrix(matrix, place)
    model, lens = values.require_lens(coefficients, where)
    return values.make_camera(name, place, size, focal, center, lens, model)
