"""VIC-3D's project or calibration XML (``calibration``, ``camera``, ``orientation``), which is only read.

Each ``camera`` has ``cx cy fx fy skew k1 k2 k3`` in px and an ``orientation`` ``alpha beta gamma Tx Ty Tz``: degrees,
and the unit of the calibration target, taken as mm. x_cam = R x_world + T with R = Rz(gamma) Ry(beta) Rx(alpha); the
world lies between the cameras, so that the first camera becomes the core. k1, k2, k3 multiply r², r⁴, r⁶ of the
undistorted x/z, y/z, as in OpenCV. The size of the images stands in ``polygonmask`` and is one for all cameras. Pixel
(0, 0) is taken as the centre of the top-left pixel. Cameras are named ``cam<id>``.

Lost: the skew; a warning gives the shift of the image in px without it.

Source: the order of the numbers and the angles are those of DICe's reader (DICe_CameraSystem.cpp, DICe_Camera.cpp,
https://github.com/dicengine/dice). It leaves the powers of r open and drops k3; r², r⁴, r⁶ follow from its own
example GT4: 119 correspondences lie beside their epipolar lines with a robust sigma of 0.038 px with them, 0.042 px
without distortion, 0.21 px with r, r² and no k3.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.files.exchange import values
from beltscape.files.exchange.documents import read_document
from beltscape.files.exchange.rig_description import RigDescription

SKEW_PX = 1e-3
"""A skew that shifts the image by less is ignored without a warning: far below the error of a detected corner."""


def is_of_format(document: Any) -> bool:
    """Return whether the document is XML with a camera that has an orientation."""
    return isinstance(document, Element) and document.find(".//camera/orientation") is not None


def read(path: Path, warn: Callable[[str], None]) -> RigDescription:
    """Read the cameras of a project; the first is the core."""
    document = read_document(path)
    if not is_of_format(document):
        raise ValueError("holds no camera with an orientation; give a calibration or project XML of VIC-3D")
    entries = document.findall(".//camera")
    names = values.require_distinct([f"cam{_attribute(entry, 'id', 'camera')}" for entry in entries])
    size = _size(document)
    cameras = {name: _camera(name, entry, size, warn) for name, entry in zip(names, entries, strict=True)}
    poses = {name: _pose(name, entry) for name, entry in zip(names, entries, strict=True)}
    return RigDescription(cameras, poses, names[0])


def rotation_from_angles(degrees: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Rz(gamma) Ry(beta) Rx(alpha) (3, 3) of alpha, beta, gamma (3,) in degrees."""
    (ca, cb, cg), (sa, sb, sg) = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    about_x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    about_y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    about_z = np.array([[cg, -sg, 0], [sg, cg, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def _camera(name: str, entry: Element, size: list[str], warn: Callable[[str], None]) -> Camera:
    cx, cy, fx, fy, skew, k1, k2, k3 = values.require_numbers((entry.text or "").split(), f"camera {name}", 8)
    camera = values.make_camera(name, name, size, [fx, fy], [cx, cy], [k1, k2, 0.0, 0.0, k3])
    moved_px = abs(skew) * max(cy, camera.size_px[1] - 1 - cy) / fy
    if moved_px > SKEW_PX:
        warn(
            f"{name}: its skew of {skew:.3g} px is left out, which moves the image by up to {moved_px:.2g} px"
        )
    return camera


def _pose(name: str, entry: Element) -> Pose:
    orientation = entry.find("orientation")
    text = "" if orientation is None else orientation.text or ""
    numbers = values.require_numbers(text.split(), f"orientation of camera {name}", 6)
    return Pose(rotation_from_angles(numbers[:3]), numbers[3:])


def _size(document: Element) -> list[str]:
    """Return [width, height] of the images."""
    masks = document.findall(".//polygonmask")
    sizes = {(_attribute(m, "width", "polygonmask"), _attribute(m, "height", "polygonmask")) for m in masks}
    if len(sizes) != 1:
        problem = "no polygonmask has" if not sizes else f"{len(sizes)} polygonmasks differ in"
        raise ValueError(f"{problem} the size of the images; give a project XML with one area of interest")
    return list(sizes.pop())


def _attribute(entry: Element, key: str, place: str) -> str:
    value = entry.get(key)
    if value is None:
        raise ValueError(f"{place} has no {key}")
    return value
