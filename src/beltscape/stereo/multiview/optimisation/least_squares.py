"""Dense least squares over all views, which determines a surface to a hundredth of a pixel.

Every iteration warps the auxiliaries by the current surface, including its slopes, forms the normal equations of
every pixel (information and pull) from the residuals, and fits a plane around each pixel over the largest window
that agrees with the smaller ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.least_squares.normal_equations import NormalEquations
from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.surface import Surface
from beltscape.stereo.multiview.frame.windows import Radii


@dataclass(frozen=True, slots=True, eq=False)
class LeastSquaresResult:
    """An optimised surface and how well the images determine it."""

    surface: Surface
    variance: NDArray[np.float32]
    """(H, W) of s, px², from noise, texture, views and window."""
    disagreement: NDArray[np.float32]
    """(H, W) deviation between the windows' planes, in units of the smaller window's variance."""
    used: NDArray[np.uint8]
    """(H, W) number of views that agree with the core."""
    information: NDArray[np.float32]
    """(H, W) of the pixel alone, 1/px²."""


def form_normal_equations(
    s: NDArray[np.float32], prepared: PreparedFrame, levels_px: int, model_variance: float
) -> NormalEquations:
    """Return the normal equations of inverse depth s (H, W), with the noise of the prepared frame.

    ``levels_px`` is the radius of the window in which levels are normalised.
    """
    context = prepared.context
    return context.kernels.normal_equations(
        s, prepared.core, prepared.coefficients, prepared.views, window=levels_px, floor=prepared.noise.floor,
        noise_variance=prepared.noise.levels, model_variance=model_variance, threads=context.threads,
    )  # fmt: skip


def solve_least_squares(
    surface: Surface, prepared: PreparedFrame, tolerances: tuple[float, ...], radii: Radii
) -> LeastSquaresResult:
    """Return the surface after one iteration per tolerance, with windows of ``radii``.

    A tolerance (px) is the distance from a pixel's plane up to which a neighbour counts.
    """
    context = prepared.context
    fit = used = information = None
    for tolerance in tolerances:
        information, pull, used = form_normal_equations(
            surface.s, prepared, context.windows.levels_px, prepared.noise.model
        )
        fit = context.kernels.local_fit(
            information, pull, surface.s, surface.slope_u, surface.slope_v, radii=radii, tolerance=tolerance,
            threads=context.threads,
        )  # fmt: skip
        surface = Surface(fit.s, fit.slope_u, fit.slope_v)
    if fit is None or used is None or information is None:
        raise ValueError("the least squares need at least one tolerance")
    return LeastSquaresResult(surface, fit.variance, fit.disagreement, used, information)
