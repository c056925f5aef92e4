"""The domain of validity of a lens: the greatest disc about the axis in which distortion is one to one."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Array
from beltscape.core.geometry.lens import MODELS, LensModel

_FARTHEST = 10.0
"""Radius up to which a lens without turning point is searched for folds of its other terms: 84° off the axis."""
_DIRECTIONS, _RADII, _BISECTIONS = 64, 200, 40
"""Directions and radii at which a fold is searched, and halvings of the interval between two radii, which leave the
rounding of a double."""
_INVERSE_SAMPLES = 512
"""Radii of the table at which an inversion starts, at even angles off the axis: a factor is interpolated to 1e-5."""
BEFORE_POLE = 1 - 1e-9
"""Share of the domain's radius at which a rational factor is evaluated at its end, where it may have a pole."""


def find_valid_radius(model: str, coefficients: Array) -> float:
    """Return the radius of the domain of a lens, in undistorted image-plane coordinates (tan θ off the axis).

    Within it the distorted radius rises with the undistorted one, and tangential, prism and tilt terms fold nothing:
    the radial factor's turning point is the exact root of a polynomial; what the other terms take from it is searched
    for in 64 directions. ∞ if the lens is one to one in front of the camera.
    """
    return _find_valid_radius(model, tuple(map(float, coefficients)))


def find_radius_of_image_radius(model: str, coefficients: Array, image_radius: float) -> float:
    """Return the undistorted radius whose radial image is ``image_radius`` (over the focal length); ∞ without any."""
    return _find_radius_of_image_radius(model, tuple(map(float, coefficients)), image_radius)


@lru_cache(maxsize=1024)
def _find_radius_of_image_radius(model: str, values: tuple[float, ...], image_radius: float) -> float:
    lens, turning, coefficients = MODELS[model], _find_valid_radius(model, values), np.array(values)
    low, high = 0.0, min(BEFORE_POLE * turning, 1e3)
    if _image_radius(lens, coefficients, high) < image_radius:
        return turning
    for _ in range(100):
        middle = 0.5 * (low + high)
        is_below = _image_radius(lens, coefficients, middle) < image_radius
        low, high = (middle, high) if is_below else (low, middle)
    return high


def tabulate_inverse(model: str, coefficients: Array) -> tuple[Array, Array]:
    """Return ascending distorted radii and their undistorted radii, a table to start the inversion of a lens at."""
    radius = min(BEFORE_POLE * find_valid_radius(model, coefficients), _FARTHEST)
    undistorted: Array = np.tan(np.linspace(0.0, float(np.arctan(radius)), _INVERSE_SAMPLES))
    distorted = undistorted * MODELS[model].radial.compute(undistorted**2, coefficients)
    return np.maximum.accumulate(distorted), undistorted


@lru_cache(maxsize=1024)
def _find_valid_radius(model: str, values: tuple[float, ...]) -> float:
    lens, coefficients = MODELS[model], np.array(values)
    turning = lens.radial.find_turning_point(coefficients)
    others = [value for name, value in zip(lens.coefficients, values, strict=True) if name[0] in "pst"]
    return _find_first_fold(lens, coefficients, turning) if any(others) else turning


def _find_first_fold(lens: LensModel, coefficients: Array, turning: float) -> float:
    """Return the least radius at which the mapping's determinant vanishes in any direction, at most ``turning``."""
    farthest = min(turning, _FARTHEST)
    angles = np.linspace(0, 2 * np.pi, _DIRECTIONS, endpoint=False)
    radii = np.linspace(0, farthest, _RADII)
    folded = ~_is_one_to_one(lens, coefficients, radii[:, None], angles)
    if not folded.any():
        return turning
    first = np.argmax(folded, axis=0)[folded.any(axis=0)]
    low, high, angles = radii[first - 1], radii[first], angles[folded.any(axis=0)]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        valid = _is_one_to_one(lens, coefficients, middle, angles)
        low, high = np.where(valid, middle, low), np.where(valid, high, middle)
    return float(low.min())


def _is_one_to_one(lens: LensModel, coefficients: Array, radius: Array, angle: Array) -> NDArray[np.bool_]:
    with np.errstate(all="ignore"):
        xx, xy, yx, yy = lens.differentiate(radius * np.cos(angle), radius * np.sin(angle), coefficients)
        return xx * yy > xy * yx


def _image_radius(lens: LensModel, coefficients: Array, radius: float) -> float:
    return radius * float(lens.radial.compute(np.array(radius * radius), coefficients))
