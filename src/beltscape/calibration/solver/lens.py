"""Intrinsics of cameras as rows of numbers, and the prior that keeps a lens plausible without informative images."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.lens import MODELS

Array = NDArray[np.float64]
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
