"""Checked access to values of parsed YAML and JSON; a ValueError names the key, its value and the fix.

Rotations as unit quaternions (w, x, y, z), as COLMAP and ROS give them, in Hamilton's convention, like Eigen's.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.checks import is_dict
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.lens import MODELS
from beltscape.core.geometry.pose import Pose

MM_PER_M = 1000.0
"""The other programs' lengths are in metres."""
ROUNDED = 1e-3
"""Largest error of a rotation's elements or a quaternion's length: three decimals are the fewest in use."""
_EXACT = 1e-12
"""A rotation with less error is taken as it is: only rounding of doubles separates it from the nearest one."""
_NOTICEABLE = 1e-6
"""A larger error gives a warning: on an image 4000 px wide it moves a pixel by 0.004."""
_MESSAGE_LENGTH = 60
"""Longest quoted value in a message, characters."""
MM_PER = {"mm": 1.0, "cm": 10.0, "m": MM_PER_M}
"""Units of length that a file may state, in mm."""


def require_value(entry: Any, key: str, place: str = "") -> Any:
    """Return ``entry[key]`` of a table."""
    if not is_dict(entry):
        raise ValueError(f"{place or 'the file'} must be a table")
    if entry.get(key) is None:
        raise ValueError(f"{place}.{key} is missing".removeprefix("."))
    return entry[key]


def require_table(item: Any, place: str) -> dict[str, Any]:
    """Return ``item`` if it is a table."""
    if not is_dict(item):
        raise ValueError(f"{place} = {_short(item)}: must be a table")
    return item


def require_numbers(item: Any, place: str, *shape: int) -> NDArray[np.float64]:
    """Return finite float64 numbers of ``shape``; -1 stands for any length."""
    try:
        array = np.array(item, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.array(np.nan)
    fits = array.ndim == len(shape) and all(want in (-1, have) for want, have in zip(shape, array.shape))  # noqa: B905
    if not fits or not np.isfinite(array).all():
        size = "a list of" if shape == (-1,) else "×".join(map(str, shape))
        raise ValueError(f"{place} = {_short(item)}: must be {size} finite numbers")
    return array


def require_matrix(item: Any, place: str, *shape: int) -> NDArray[np.float64]:
    """Return the matrix of ``{rows, cols, data}``, as OpenCV and ROS write it; shape -1: a row or column."""
    rows, cols = (
        int(require_numbers(require_value(item, key, place), f"{place}.{key}")) for key in ("rows", "cols")
    )
    data = require_numbers(require_value(item, "data", place), f"{place}.data", -1)
    if data.size != rows * cols:
        raise ValueError(f"{place} has {data.size} numbers, not {rows}×{cols}")
    if shape == (-1,):
        return data
    if (rows, cols) != shape:
        raise ValueError(f"{place} is {rows}×{cols}: must be {'×'.join(map(str, shape))}")
    return data.reshape(shape)


def require_translation(entry: Any, key: str, place: str = "") -> NDArray[np.float64]:
    """Return the three numbers of a translation that is stored as a matrix, in the file's unit."""
    where = f"{place}.{key}".removeprefix(".")
    translation = require_matrix(require_value(entry, key, place), where, -1)
    if translation.size != 3:
        raise ValueError(f"{where} has {translation.size} numbers: must be 3")
    return translation


def split_camera_matrix(
    k: NDArray[np.float64], place: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return focal lengths (2,) and principal point (2,), px, of a camera matrix (3, 3) without skew."""
    if k[0, 1] or k[1, 0] or (k[2] != [0, 0, 1]).any():
        raise ValueError(f"{place} = {k.tolist()}: must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
    return np.diag(k)[:2].copy(), k[:2, 2].copy()


def require_lens(
    coefficients: NDArray[np.float64], place: str, *, is_fisheye: bool = False
) -> tuple[str, NDArray[np.float64]]:
    """Return the smallest lens model that holds OpenCV's 0, 4, 5, 8, 12 or 14 coefficients, and its coefficients.

    Those of a fisheye are k1, k2, k3, k4.
    """
    if is_fisheye:
        return "fisheye", require_fisheye(coefficients, place)
    if coefficients.size not in (0, 4, 5, 8, 12, 14):
        raise ValueError(
            f"{place} has {coefficients.size} coefficients: must be 4, 5, 8, 12 or 14 (k1, k2, p1, p2, k3, …)"
        )
    counts = {name: len(MODELS[name].coefficients) for name in ("brown", "rational", "thin_prism", "tilted")}
    model = next(name for name, count in counts.items() if not coefficients[count:].any())
    taken = coefficients[: counts[model]]
    return model, np.concatenate([taken, np.zeros(counts[model] - taken.size)])


def require_fisheye(coefficients: NDArray[np.float64], place: str) -> NDArray[np.float64]:
    """Return k1, k2, k3, k4 (4,) of the fisheye model."""
    if coefficients.size != 4:
        raise ValueError(f"{place} has {coefficients.size} coefficients: a fisheye has k1, k2, k3, k4")
    return coefficients


def require_writable(camera: Camera, program: str, models: tuple[str, ...]) -> None:
    """Refuse a lens model that another program does not have."""
    if camera.model not in models:
        raise ValueError(
            f"camera {camera.name}: {program} has no lens model like {camera.model}; calibrate with --lens-model "
            f"{' or '.join(models)}, or export to opencv"
        )


def require_camera(name: str, entry: Any, place: str, *, is_fisheye: bool = False) -> Camera:
    """Return the camera of a table with the keys that OpenCV's samples and ROS share."""
    k = require_matrix(require_value(entry, "camera_matrix", place), f"{place}.camera_matrix", 3, 3)
    where = f"{place}.distortion_coefficients"
    coefficients = require_matrix(require_value(entry, "distortion_coefficients", place), where, -1)
    size = [require_value(entry, key, place) for key in ("image_width", "image_height")]
    focal, center = split_camera_matrix(k, f"{place}.camera_matrix")
    model, lens = require_lens(coefficients, where, is_fisheye=is_fisheye)
    return make_camera(name, place, size, focal, center, lens, model)


def make_camera(
    name: str, place: str, size: Any, focal: Any, center: Any, coefficients: Any, model: str = "brown"
) -> Camera:
    """Return a camera of checked size (width, height), focal length and principal point (px), with its lens."""
    size_px = require_numbers(size, f"{place}: image width and height", 2)
    if size_px.min() < 1 or (size_px % 1).any():
        raise ValueError(f"{place}: image width and height = {size}: must be positive whole numbers")
    if min(focal) <= 0:
        raise ValueError(f"{place}: focal length = {np.asarray(focal).tolist()}: must be positive")
    return Camera(
        name=name,
        size_px=(int(size_px[0]), int(size_px[1])),
        focal_px=np.asarray(focal, dtype=np.float64),
        center_px=np.asarray(center, dtype=np.float64),
        distortion=np.asarray(coefficients, dtype=np.float64),
        model=model,
    )


def make_pose(
    place: str,
    rotation: NDArray[np.float64],
    translation_mm: NDArray[np.float64],
    warn: Callable[[str], None],
) -> Pose:
    """Return a pose; a rounded rotation (3, 3) becomes the nearest one, with a warning beyond 1e-6."""
    u, _, vt = np.linalg.svd(rotation)
    nearest = u @ vt
    off = float(np.abs(nearest - rotation).max())
    if off > ROUNDED or np.linalg.det(nearest) < 0:
        raise ValueError(f"{place} is not a rotation (orthonormal, determinant +1)")
    if off > _NOTICEABLE:
        warn(f"{place} is rounded: it is off a rotation by {off:.1g}; the nearest one is taken")
    return Pose(rotation if off < _EXACT else nearest, translation_mm)


def require_unit(document: Any) -> float:
    """Return the mm of the unit that a file states under ``units``; programs that write none need it added."""
    unit = document.get("units") if is_dict(document) else None
    if not isinstance(unit, str) or unit not in MM_PER:
        raise ValueError(
            f"units = {_short(unit)}: the unit of its translations is not known; add a line such as units: mm "
            f"({', '.join(MM_PER)})"
        )
    return MM_PER[unit]


def require_known(item: Any, place: str, names: tuple[str, ...], fix: str) -> str:
    """Return ``item`` if it is one of ``names``; refuse other models by name."""
    if item not in names:
        raise ValueError(f"{place} = {_short(item)} is not known, only {', '.join(names)}; {fix}")
    return str(item)


def require_distinct(names: list[str]) -> list[str]:
    """Return ``names`` if no two are equal."""
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ValueError(f"two cameras are named {twice!r}; rename one")
    return names


def _short(item: Any) -> str:
    text = repr(item)
    return text if len(text) <= _MESSAGE_LENGTH else f"{text[: _MESSAGE_LENGTH - 3]}..."


def wxyz_from_rotation(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit quaternion (4,) with w ≥ 0 of a rotation matrix (3, 3)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True)


def rotation_from_wxyz(wxyz: NDArray[np.float64], place: str) -> NDArray[np.float64]:
    """Return the rotation matrix (3, 3) of a quaternion; ValueError unless its length is 1 up to rounding."""
    from scipy.spatial.transform import Rotation

    length = float(np.linalg.norm(wxyz))
    if abs(length - 1) > ROUNDED:
        raise ValueError(f"{place} = {wxyz.tolist()}: must be a unit quaternion, its length is {length:.4g}")
    return Rotation.from_quat(wxyz, scalar_first=True).as_matrix()
