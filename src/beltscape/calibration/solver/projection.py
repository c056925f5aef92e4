"""Projection of points through lens models, with its Jacobians, for many observations at once.

Returned arrays have the observations last in memory, whatever their shape: sums over them are faster that way.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.lens import MODELS

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

ModelRows = tuple[tuple[str, slice | Indices], ...]
"""Lens models, each with the observations whose cameras have it."""


def group_by_model(models: Sequence[str], camera: Indices) -> ModelRows:
    """Return the lens models of cameras, each with the rows of ``camera`` (N,), the observations' cameras."""
    names = tuple(dict.fromkeys(models))
    if len(names) == 1:
        return ((names[0], slice(None)),)
    index = np.array([names.index(model) for model in models])[camera]
    return tuple((name, np.flatnonzero(index == i)) for i, name in enumerate(names))


def project_with_jacobians(
    points: Array, intrinsics: Array, model: str | ModelRows = "brown"
) -> tuple[Array, Array, Array]:
    """Project points in camera frames to pixels, with derivatives; the lens model's domain is not checked.

    Parameters
    ----------
    points
        (N, 3) each in the frame of the camera that sees it, mm.
    intrinsics
        (N, W) fx, fy, cx, cy and the coefficients of that camera, zeros after them; (W,) if one camera sees all.
    model
        The lens model of all cameras, or the rows of each.

    Returns
    -------
    (N, 2) pixels, (N, 2, 3) their derivatives by the point, (N, 2, W) by the intrinsics.
    """
    if isinstance(model, str) or len(model) == 1:
        return _differentiate_model(points, intrinsics, model if isinstance(model, str) else model[0][0])
    count, width = len(points), intrinsics.shape[1]
    pixels, by_point = np.empty((2, count)), np.empty((3, 2, count))
    by_intrinsics = np.zeros((width, 2, count))
    for name, rows in model:
        own = _differentiate_model(points[rows], intrinsics[rows], name)
        pixels[:, rows], by_point[..., rows], by_intrinsics[..., rows] = (each.T for each in own)
    return pixels.T, by_point.T, by_intrinsics.T


def _differentiate_model(points: Array, intrinsics: Array, model: str) -> tuple[Array, Array, Array]:
    lens = MODELS[model]
    end = 4 + len(lens.coefficients)
    fx, fy, cx, cy, *_ = intrinsics.T
    coefficients = intrinsics.T[4:end]
    inverse = 1.0 / points[:, 2]
    x, y = points[:, 0] * inverse, points[:, 1] * inverse
    xd, yd = lens.distort(x, y, coefficients)
    pixels = np.stack([fx * xd + cx, fy * yd + cy])

    xx, xy, yx, yy = lens.differentiate(x, y, coefficients)
    by_point = np.empty((3, 2, len(points)))
    by_point[0, 0] = fx * inverse * xx
    by_point[1, 1] = fy * inverse * yy
    by_point[1, 0], by_point[0, 1] = fx * inverse * xy, fy * inverse * yx
    by_point[2] = -(by_point[0] * x + by_point[1] * y)

    by_intrinsics = np.zeros((intrinsics.shape[-1], 2, len(points)))
    by_intrinsics[0, 0], by_intrinsics[1, 1] = xd, yd
    by_intrinsics[2, 0] = by_intrinsics[3, 1] = 1.0
    by_intrinsics[4:end] = lens.differentiate_by_coefficients(x, y, coefficients, fx, fy)
    return pixels.T, by_point.T, by_intrinsics.T


def project_points(points: Array, intrinsics: Array, model: str | ModelRows = "brown") -> Array:
    """Return the pixels (N, 2) of `project_with_jacobians` without derivatives."""
    if isinstance(model, str) or len(model) == 1:
        return _project_model(points, intrinsics, model if isinstance(model, str) else model[0][0])
    pixels = np.empty((2, len(points)))
    for name, rows in model:
        pixels[:, rows] = _project_model(points[rows], intrinsics[rows], name).T
    return pixels.T


def _project_model(points: Array, intrinsics: Array, model: str) -> Array:
    lens = MODELS[model]
    fx, fy, cx, cy, *_ = intrinsics.T
    coefficients = intrinsics.T[4 : 4 + len(lens.coefficients)]
    u, v = lens.distort(points[:, 0] / points[:, 2], points[:, 1] / points[:, 2], coefficients)
    return np.stack([fx * u + cx, fy * v + cy]).T


def rotate_vectors(rotations: Array, vectors: Array) -> Array:
    """Return vectors (N, 3), each rotated by its own rotation (N, 3, 3)."""
    x, y, z = vectors.T
    r = rotations.T  # r[j, i]: row i, column j
    return (r[0] * x + r[1] * y + r[2] * z).T


def differentiate_by_pose(by_point: Array, rotated: Array) -> Array:
    """Return derivatives (N, 2, 6) by a small rotation (rad, in the target frame's axes) and translation (mm).

    ``by_point`` (N, 2, 3) are derivatives by the transformed point; ``rotated`` (N, 3) is the rotated point
    before translation:
    d(exp(ω) R p + t) = ω × R p + dt.
    """
    (a, b, c), (x, y, z) = by_point.T, rotated.T
    # (J · (ω × q)) = ω · (q × J)
    return np.stack([y * c - z * b, z * a - x * c, x * b - y * a, a, b, c]).T
