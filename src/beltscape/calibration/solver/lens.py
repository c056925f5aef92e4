"""Lenses as rows of numbers with their prior, and the projection of points through them.

A general prior keeps a lens plausible without informative images; an earlier calibration gives one with its
covariance. Points are projected with their Jacobians for many observations at once; the pose of a board follows from
one view with known intrinsics.

Returned arrays have the observations last in memory, whatever their shape: sums over them are faster that way.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Array, Indices
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.lens import MODELS
from beltscape.core.geometry.pose import Pose

Number = TypeVar("Number", np.float64, np.bool_)

PINHOLE = ("fx", "fy", "cx", "cy")
"""The parameters before the coefficients of the lens model."""
ASPECT_SIGMA = 0.005
"""Standard deviation of fx - fy over their mean."""
TILTED_ASPECT_SIGMA = 2e-4
"""The same of a tilted sensor: its pixels are square, so that a difference is the tilt's (1/cos τ: 0.4 % at 5°)."""
TILTED_DECENTRING_SIGMA = 3e-4
"""Standard deviation of p1 and p2 of a tilted sensor, as of good lenses: to second order decentring is a tilt, so
that without this limit no view determines the angles."""
STRETCHED = 0.05
"""Least relative difference of fx and fy of stretched images; pixels of sensors are square within 0.001."""
CENTER_SIGMA = 0.03
"""Standard deviation of the principal point about the image's centre, over the image's width."""
COEFFICIENT_SIGMA = {
    **{"k1": 0.5, "k2": 0.7, "p1": 0.005, "p2": 0.005, "k3": 0.7, "k4": 0.7, "k5": 0.7, "k6": 0.7},
    **dict.fromkeys(("s1", "s2", "s3", "s4"), 0.005),
    **dict.fromkeys(("tau_x", "tau_y"), 0.2),
}
"""Standard deviations of the coefficients about 0; 0.2 rad of tilt is a Scheimpflug adapter at its end."""
RATIONAL_PRIOR = {
    **{"k1": (7 / 9, 0.7), "k2": (64 / 945, 0.7), "k3": (0.0, 0.2)},
    **{"k4": (10 / 9, 0.3), "k5": (5 / 21, 0.1), "k6": (0.0, 0.02)},
}
"""Mean and standard deviation of the rational factor: the Padé approximant of an equidistant fisheye, atan(r)/r.

Numerator and denominator may have a common factor, which no image determines; its root may be a pole in the image,
but about this mean the denominator stays positive.
"""


def list_parameters(model: str) -> tuple[str, ...]:
    """Return the names of the intrinsics of a camera with a lens model: fx, fy, cx, cy, then its coefficients."""
    return (*PINHOLE, *MODELS[model].coefficients)


def pack_intrinsics(camera: Camera) -> Array:
    """Return the intrinsics (4 + n,) fx, fy, cx, cy and the n coefficients of the lens model."""
    return np.array([*camera.focal_px, *camera.center_px, *camera.distortion])


def stack_intrinsics(cameras: Iterable[Camera]) -> Array:
    """Return the intrinsics (C, W) of cameras, rows of smaller models filled with zeros to the greatest one's W."""
    return pad_rows([pack_intrinsics(camera) for camera in cameras])


def pad_rows(rows: Iterable[NDArray[Number]]) -> NDArray[Number]:
    """Return arrays (W_i, ...) as (C, W, ...) with zeros beyond each one's own size, in all axes."""
    rows = list(rows)
    width = max(len(row) for row in rows)
    return np.stack([np.pad(row, [(0, width - len(row))] * row.ndim) for row in rows])


def unpack_intrinsics(camera: Camera, values: Array) -> Camera:
    """Return the camera with the intrinsics of a row of `stack_intrinsics`."""
    end = len(PINHOLE) + len(camera.distortion)
    return replace(
        camera,
        focal_px=values[:2].copy(),
        center_px=values[2:4].copy(),
        distortion=values[4:end].copy(),
    )


def compute_lens_prior(camera: Camera) -> tuple[Array, Array]:
    """Return mean (W,) and information (W, W) of a lens's parameters; the focal length itself has no prior.

    The prior is a hundred times wider than the estimate from a good set of views, so it matters only without them.
    """
    width, height = camera.size_px
    focal = float(camera.focal_px.mean())
    coefficients = camera.lens.coefficients
    center = (width - 1) / 2, (height - 1) / 2
    means, sigmas = zip(*(get_coefficient_prior(name, camera.model) for name in coefficients), strict=True)
    aspect = _get_aspect(camera)
    mean = np.array([focal * aspect, focal / aspect, *center, *means])
    information = np.zeros((len(mean), len(mean)))
    aspect_sigma = TILTED_ASPECT_SIGMA if camera.lens.has_tilt else ASPECT_SIGMA
    information[:2, :2] = np.array([[aspect**-2, -1.0], [-1.0, aspect**2]]) / (aspect_sigma * focal) ** 2
    information[[2, 3], [2, 3]] = 1 / (CENTER_SIGMA * width) ** 2
    places = range(len(PINHOLE), len(mean))
    information[places, places] = np.array(sigmas) ** -2.0
    return mean, information


def _get_aspect(camera: Camera) -> float:
    """Return √(fx/fy) of a camera whose pixels are far from square, as of stretched images; else 1."""
    ratio = float(camera.focal_px[0] / camera.focal_px[1])
    return ratio**0.5 if abs(ratio - 1) > STRETCHED else 1.0


def get_coefficient_prior(name: str, model: str) -> tuple[float, float]:
    """Return mean and standard deviation of a coefficient of a lens model."""
    if MODELS[model].has_tilt and name in ("p1", "p2"):
        return 0.0, TILTED_DECENTRING_SIGMA
    is_rational = "k6" in MODELS[model].coefficients
    if is_rational and name in RATIONAL_PRIOR:
        return RATIONAL_PRIOR[name]
    return 0.0, COEFFICIENT_SIGMA[name]


@dataclass(frozen=True, slots=True, eq=False)
class LensPrior:
    """Mean and covariance of a camera's intrinsics; parameters without variance are fixed."""

    camera: Camera
    covariance: Array
    """(W, W) of fx, fy, cx, cy and the coefficients of the lens model."""

    @property
    def fixed(self) -> tuple[str, ...]:
        """Parameters that keep their value."""
        names = list_parameters(self.camera.model)
        return tuple(
            name for name, variance in zip(names, np.diag(self.covariance), strict=True) if variance <= 0
        )

    def compute_information(self) -> tuple[Array, Array]:
        """Return mean (W,) and information (W, W); 0 for fixed parameters."""
        free = np.diag(self.covariance) > 0
        information = np.zeros_like(self.covariance)
        information[np.ix_(free, free)] = np.linalg.inv(self.covariance[np.ix_(free, free)])
        return pack_intrinsics(self.camera), information


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


MIN_POINTS = 4
"""Least number of coplanar points that determine a pose."""


def count_usable_points(camera: Camera, pixels: Array) -> int:
    """Return how many pixels (n, 2) lie within the domain of validity of a camera's lens."""
    return int(np.isfinite(camera.undistort(pixels)).all(axis=1).sum())


def fit_view_pose(camera: Camera, points_mm: Array, pixels: Array, *, refine: bool = False) -> Pose:
    """Return cam_from_board from points (n, 3) and their pixels (n, 2).

    Pixels beyond the lens's domain of validity are left out. ``refine`` minimises the errors in undistorted
    coordinates after the closed solution.

    Raises
    ------
    CalibrationError
        When fewer than four pixels lie within the domain.
    """
    ideal = camera.undistort(pixels)
    is_usable = np.isfinite(ideal).all(axis=1)
    if is_usable.sum() < MIN_POINTS:
        raise CalibrationError(
            f"camera {camera.name}: only {is_usable.sum()} of {len(pixels)} corners of a view lie where its lens "
            f"model {camera.model} is valid; calibrate it with a model for wider lenses"
        )
    points, ideal = points_mm[is_usable], ideal[is_usable]
    _, rotation, shift = cv2.solvePnP(points, ideal, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
    if refine:
        rotation, shift = cv2.solvePnPRefineLM(points, ideal, np.eye(3), None, rotation, shift)
    return Pose.of(rotation, shift)
