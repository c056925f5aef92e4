"""Row error of an auxiliary as a function of place: a robust fit of its epipolar residuals over the core's image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.stereo.consistency.systematic_residual import LEAST_POINTS
from beltscape.stereo.consistency.tie_points.tie_points import Array

TERMS = 4
"""Offset, slope in x, slope in y, and change with the inverse depth."""
_NEAR_PX = 1.0
"""A point agrees with the fitted function within this distance, px of the matched images."""
_SAMPLES = 200
"""Number of random samples of `TERMS` points; where 43 % of the matches are right, 99.9 % of the draws hold a sample
without a false one."""
_REFITS = 4
"""Fits to the points near the function before; the points that agree no longer change then."""
_USED_SIGMAS = 3.0
"""Points beyond this number of standard deviations agree, but are not fitted: chance matches among the right ones."""
_PRIOR_PX = 40.0
"""Standard deviation of each term before it is measured; bounds what a plane surface leaves open."""


@dataclass(frozen=True, slots=True)
class RowFit:
    """The function that most points of an image agree with, along the normals of their epipolar lines; NaN: none."""

    offset_px: float
    """In the middle of the image, at the mean depth."""
    slope_x_px: float
    """Change from the middle of the core's image to its right edge."""
    slope_y_px: float
    """Change from the middle of the core's image to its lower edge."""
    depth_px: float
    """Change by one standard deviation of the points' inverse depths, where these are not a plane's."""
    rms_px: float
    """RMS of the function over the points that agree with it."""
    sigma_px: float
    """One standard deviation of the offset."""
    explained: int
    """Number of points that agree with the function."""

    @property
    def extent_px(self) -> tuple[float, float]:
        """Return the least and greatest row error over the image, at the mean depth; NaN: not measured."""
        slope = abs(self.slope_x_px) + abs(self.slope_y_px)
        return self.offset_px - slope, self.offset_px + slope


_NAN = float("nan")
NO_FIT = RowFit(_NAN, _NAN, _NAN, _NAN, _NAN, _NAN, 0)
"""The fit where there are too few points."""


def fit_rows(
    epipolar_px: Array,
    pixels: Array,
    inverse_depth: Array,
    size_px: tuple[int, int],
    pixel_scale: float = 1.0,
) -> RowFit:
    """Fit the row error to epipolar residuals (N,), NaN where missing, at pixels (N, 2) of the core's image.

    The function is the one with which most points agree, so that false matches do not count. ``inverse_depth`` is
    (N,), and ``pixel_scale`` the pixel of the images in which the points were matched, in px of the rig's images.
    """
    good = np.isfinite(epipolar_px) & np.isfinite(inverse_depth)
    values, near = epipolar_px[good], _NEAR_PX * pixel_scale
    if len(values) < LEAST_POINTS:
        return NO_FIT
    design = _make_design(pixels[good], inverse_depth[good], size_px)
    agrees = _find_consensus(design, values, near)
    terms, used, scatter = np.zeros(TERMS), agrees, near
    for _ in range(_REFITS):
        normal = design[used].T @ design[used] + np.eye(TERMS) * (near / _PRIOR_PX) ** 2
        terms = np.asarray(np.linalg.solve(normal, design[used].T @ values[used]), np.float64)
        left = np.abs(values - design @ terms)
        agrees = left < near
        if agrees.sum() < LEAST_POINTS:
            return NO_FIT
        scatter = MAD_TO_SIGMA * float(np.median(left[agrees]))
        used = left <= min(near, _USED_SIGMAS * scatter)
    rms = float(np.sqrt(np.mean(np.square(design[agrees] @ terms))))
    sigma = scatter / float(np.sqrt(agrees.sum()))
    offset, slope_x, slope_y, depth = (float(term) for term in terms)
    return RowFit(offset, slope_x, slope_y, depth, rms, sigma, int(agrees.sum()))


def _make_design(pixels: Array, inverse_depth: Array, size_px: tuple[int, int]) -> Array:
    """Return (N, 4) of 1, x and y from -1 to 1 over the image, and what these leave of the scaled inverse depth.

    On a plane they leave nothing of it, and the slopes hold all.
    """
    place = np.column_stack([np.ones(len(pixels)), 2 * (pixels + 0.5) / size_px - 1])
    middle = float(np.median(inverse_depth))
    spread = MAD_TO_SIGMA * float(np.median(np.abs(inverse_depth - middle)))
    depth = np.clip((inverse_depth - middle) / max(spread, 1e-12), -3, 3)
    left = depth - place @ np.linalg.lstsq(place, depth)[0]
    return np.column_stack([place, left])


def _find_consensus(design: Array, values: Array, near_px: float) -> NDArray[np.bool_]:
    """Return (N,) the points that agree with the function through random points that most agree with.

    The rig as it is, and a mere offset, are among the functions that are tried first.
    """
    rng = np.random.default_rng(0)
    trials = [np.zeros(TERMS), np.array([float(np.median(values)), 0.0, 0.0, 0.0])]
    best, most = np.zeros(len(values), np.bool_), -1
    for i in range(_SAMPLES + len(trials)):
        if i < len(trials):
            terms = trials[i]
        else:
            drawn = rng.choice(len(values), TERMS, replace=False)
            normal = design[drawn].T @ design[drawn] + np.eye(TERMS) * (near_px / _PRIOR_PX) ** 2
            terms = np.linalg.solve(normal, design[drawn].T @ values[drawn])
        agrees = np.abs(values - design @ terms) < near_px
        if agrees.sum() > most:
            best, most = agrees, int(agrees.sum())
    return best
