"""Joint dense least squares: all views at once move the surface to a hundredth of a pixel.

Every iteration warps the auxiliaries by the present surface, so that its slopes and curvature are in the warp,
turns the residuals into information and pull per pixel, and fits a plane around each pixel over the largest
window that agrees with the smaller ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels
from beltscape.kernels.normal_equations import NormalEquations
from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.surface import Surface
from beltscape.stereo.multiview.frame.windows import Radii


@dataclass(frozen=True, slots=True, eq=False)
class RefinementResult:
    """A refined surface and how well the images determine it."""

    surface: Surface
    variance: NDArray[np.float32]
    """(H, W) of s, px², from noise, texture, views and window."""
    disagreement: NDArray[np.float32]
    """(H, W) of the windows: how far from plane the surface is, in units of the smaller window's variance."""
    used: NDArray[np.uint8]
    """(H, W) how many views agreed."""
    information: NDArray[np.float32]
    """(H, W) of this pixel alone, 1/px²."""


def form_normal_equations(
    s: NDArray[np.float32],
    prepared: PreparedFrame,
    levels_px: int,
    model_variance: float,
    kernels: Kernels,
    threads: int,
) -> NormalEquations:
    """What a frame's images say of a surface, at the noise that was told of it."""
    return kernels.normal_equations(
        s, prepared.core, prepared.coefficients, prepared.views, window=levels_px, floor=prepared.noise.floor,
        noise_variance=prepared.noise.levels, model_variance=model_variance, threads=threads,
    )  # fmt: skip


def refine(
    surface: Surface,
    prepared: PreparedFrame,
    tolerances: tuple[float, ...],
    radii: Radii,
    levels_px: int,
    kernels: Kernels,
    threads: int,
) -> RefinementResult:
    """One iteration per tolerance (px): how far a neighbour may lie off the pixel's plane and still count.

    ``radii`` are the fit's windows, ``levels_px`` the radius of the one in which levels are normalised.
    """
    fit = used = information = None
    for tolerance in tolerances:
        information, pull, used = form_normal_equations(
            surface.s, prepared, levels_px, prepared.noise.model, kernels, threads
        )
        fit = kernels.local_fit(
            information, pull, surface.s, surface.slope_u, surface.slope_v, radii=radii, tolerance=tolerance,
            threads=threads,
        )  # fmt: skip
        surface = Surface(fit.s, fit.slope_u, fit.slope_v)
    if fit is None or used is None or information is None:
        raise ValueError("refine needs at least one tolerance")
    return RefinementResult(surface, fit.variance, fit.disagreement, used, information)
