"""Kalibr's camera chain, ``camchain.yaml``.

Cameras are ``cam0``, ``cam1``, …; ``cam0`` is the core, then the others in the rig's order. Each has
``camera_model`` pinhole, ``intrinsics`` [fu, fv, pu, pv] in px, ``distortion_model`` radtan with
``distortion_coeffs`` [k1, k2, r1, r2] (OpenCV's k1, k2, p1, p2), or equidistant with [k1, k2, k3, k4] of the fisheye
model, ``resolution`` [width, height], and from ``cam1``
on ``T_cn_cnm1``: 4×4, brings points from the camera before into this one, translation in metres. Pixel (0, 0) is
the centre of the top-left pixel: Kalibr takes OpenCV's corners.

A camera's name is kept in ``rostopic`` as ``/<name>/image_raw``, and taken from there when every topic has that
form. Lost: k3 (k1, k2, p1, p2 are refitted, and a warning gives the shift of the image in px), quality and
covariance, and the order of the cameras where the core is not the first. ``T_cam_imu`` and time shifts are not
read.

Source: https://github.com/ethz-asl/kalibr/wiki/yaml-formats and kalibr_common/ConfigReader.py
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.checks import is_dict
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.lens import MODELS
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.exchange import values
from beltscape.files.exchange.documents import read_document, to_floats, write_yaml
from beltscape.files.exchange.rig_description import RigDescription, names_core_first

_SAMPLES = 64
"""Pixels along each side of the grid on which the lens is fitted; distortion is smooth between them."""


def fit_without_k3(camera: Camera) -> tuple[NDArray[np.float64], float, float]:
    """Fit k1, k2, p1, p2 (4,) without k3; return them with the RMS and the largest shift of the image, px.

    The camera matrix is kept. The model is linear in its coefficients, so the fit over a grid of pixels is one
    linear least-squares problem.
    """
    if camera.distortion[4] == 0:
        return camera.distortion[:4].copy(), 0.0, 0.0
    width, height = camera.size_px
    u, v = np.meshgrid(np.linspace(0, width - 1, _SAMPLES), np.linspace(0, height - 1, _SAMPLES))
    ideal = camera.undistort(np.stack([u, v], axis=-1).reshape(-1, 2))
    ideal = ideal[np.isfinite(ideal).all(axis=-1)]
    moved_px = (camera.distort(ideal) - ideal) * camera.focal_px
    columns_px = _terms(ideal) * camera.focal_px[:, None]
    solution = np.linalg.lstsq(columns_px.reshape(-1, 4), moved_px.reshape(-1), rcond=None)[0]
    coefficients = np.asarray(solution, dtype=np.float64)
    error_px = np.asarray(np.linalg.norm(columns_px @ coefficients - moved_px, axis=-1), np.float64)
    return coefficients, float(np.sqrt(np.mean(error_px**2))), float(error_px.max())


def _terms(ideal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the derivatives (N, 2, 4) of the distorted x/z, y/z (N, 2) with respect to k1, k2, p1, p2."""
    x, y = ideal.T
    r2 = x * x + y * y
    along_x = [x * r2, x * r2 * r2, 2 * x * y, r2 + 2 * x * x]
    along_y = [y * r2, y * r2 * r2, r2 + 2 * y * y, 2 * x * y]
    return np.stack([np.stack(along_x, axis=-1), np.stack(along_y, axis=-1)], axis=1)


FIX = "calibrate with pinhole-radtan or pinhole-equi"
DISTORTIONS = {"radtan": "brown", "equidistant": "fisheye", "none": "brown"}
"""Kalibr's distortion models that are known, and the lens models they are."""


def is_of_format(document: Any) -> bool:
    """Return whether the document is a table with ``cam0``."""
    return is_dict(document) and is_dict(document.get("cam0"))


def write(path: Path, rig: Rig, warn: Callable[[str], None]) -> list[Path]:
    """Write the rig as a camera chain that starts at the core."""
    names = names_core_first(rig)
    document: dict[str, Any] = {}
    for i, name in enumerate(names):
        chained = {"T_cn_cnm1": _metric(rig.relative_pose(name, names[i - 1]))} if i else {}
        document[f"cam{i}"] = {
            **chained,
            "cam_overlaps": [j for j in range(len(names)) if j != i],
            **_intrinsics(rig.cameras[name], warn),
            "rostopic": f"/{name}/image_raw",
        }
    write_yaml(path, document)
    return [path]


def read(path: Path, warn: Callable[[str], None]) -> RigDescription:
    """Read a camera chain; its reference is ``cam0``."""
    document = read_document(path)
    if not is_of_format(document):
        raise ValueError("has no cam0; give a camchain.yaml of kalibr_calibrate_cameras")
    keys = [f"cam{i}" for i in range(sum(bool(re.fullmatch(r"cam\d+", str(key))) for key in document))]
    entries = {key: values.require_table(values.require_value(document, key), key) for key in keys}
    names = _names(entries)
    cameras = {name: _camera(name, key, entries[key]) for key, name in names.items()}
    poses = {names["cam0"]: Pose.identity()}
    last = Pose.identity()
    for key in keys[1:]:
        if "T_cn_cnm1" not in entries[key]:
            break  # the chain is interrupted: this camera and those behind it have no pose
        last = _pose(key, entries[key], warn) @ last
        poses[names[key]] = last
    return RigDescription(cameras, poses, names["cam0"])


def _intrinsics(camera: Camera, warn: Callable[[str], None]) -> dict[str, Any]:
    values.require_writable(camera, "Kalibr", ("brown", "fisheye"))
    if camera.model == "fisheye":
        return _entry(camera, "equidistant", camera.distortion)
    coefficients, rms_px, largest_px = fit_without_k3(camera)
    if camera.distortion[4] != 0:
        warn(
            f"camera {camera.name}: Kalibr's radtan has no k3 ({camera.distortion[4]:.4g}); k1, k2, p1, p2 were "
            f"refitted, which moves the image by {rms_px:.2g} px RMS, {largest_px:.2g} px at most"
        )
    return _entry(camera, "radtan", coefficients)


def _entry(camera: Camera, model: str, coefficients: NDArray[np.float64]) -> dict[str, Any]:
    return {
        "camera_model": "pinhole",
        "distortion_coeffs": to_floats(coefficients),
        "distortion_model": model,
        "intrinsics": to_floats([*camera.focal_px, *camera.center_px]),
        "resolution": list(camera.size_px),
    }


def _metric(pose: Pose) -> list[list[float]]:
    """Return the transform (4×4) with its translation in metres."""
    top = np.column_stack([pose.rotation, pose.translation_mm / values.MM_PER_M])
    return to_floats(np.vstack([top, [0.0, 0.0, 0.0, 1.0]]))


def _names(entries: dict[str, Any]) -> dict[str, str]:
    """Return each camera's name by its key in the chain."""
    topics = [re.fullmatch(r"/([^/]+)/image_raw", str(entry.get("rostopic"))) for entry in entries.values()]
    names = [topic[1] for topic in topics if topic]
    fits = len(set(names)) == len(entries)
    return dict(zip(entries, names if fits else entries, strict=True))


def _camera(name: str, key: str, entry: Any) -> Camera:
    values.require_known(
        values.require_value(entry, "camera_model", key), f"{key}.camera_model", ("pinhole",), FIX
    )
    model = values.require_value(entry, "distortion_model", key)
    lens = DISTORTIONS[values.require_known(model, f"{key}.distortion_model", tuple(DISTORTIONS), FIX)]
    listed = values.require_numbers(values.require_value(entry, "intrinsics", key), f"{key}.intrinsics", 4)
    distortion: NDArray[np.float64] = np.zeros(4)
    if model != "none":
        distortion = values.require_numbers(
            values.require_value(entry, "distortion_coeffs", key), f"{key}.distortion_coeffs", 4
        )
    size = values.require_value(entry, "resolution", key)
    return values.make_camera(
        name, key, size, listed[:2], listed[2:], [*distortion, 0.0][: len(MODELS[lens].coefficients)], lens
    )


def _pose(key: str, entry: Any, warn: Callable[[str], None]) -> Pose:
    place = f"{key}.T_cn_cnm1"
    listed = values.require_numbers(entry["T_cn_cnm1"], place, 4, 4)
    if not np.allclose(listed[3], [0, 0, 0, 1], rtol=0, atol=1e-9):  # exact but for rounding
        raise ValueError(f"{place} ends with the row {listed[3].tolist()}: must be [0, 0, 0, 1]")
    return values.make_pose(place, listed[:3, :3], listed[:3, 3] * values.MM_PER_M, warn)
