"""Normal equations of a surface: the change of inverse depth that reduces the residuals of all views."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.arrays import WINDOW_LIMIT, demand_within, float32, spline
from beltscape.kernels.backend import KernelFamily
from beltscape.kernels.projection import PROJECTION_SIZE


class NormalEquations(NamedTuple):
    """Least squares of one unknown per pixel, a change of s."""

    information: NDArray[np.floating]
    """(H, W) float32, 1/px²: the inverse of the change's variance, from this pixel alone."""
    pull: NDArray[np.floating]
    """(H, W) float32, 1/px: the change that this pixel alone would take is pull / information."""
    used: NDArray[np.uint8]
    """(H, W): how many views see the pixel with a misfit below the gate."""


class NormalEquationsInput(NamedTuple):
    """Checked input of `normal_equations`."""

    s: NDArray[np.float32]
    """(H, W) inverse depth on the core's undistorted grid; NaN where there is none."""
    core: NDArray[np.float32]
    """(H, W) grey levels of the core, undistorted; NaN where there are none."""
    coefficients: list[NDArray[np.float32]]
    """n of (h, w), of the auxiliaries' images from `spline_coefficients`, on the core's scale of levels."""
    views: NDArray[np.float32]
    """(n, 39) packed projections of the core's pixels into the auxiliaries, as native/view.hpp lays them out."""
    window: int
    """Radius of the normalisation's window in px, 1 to 15: the window has (2 window + 1)² pixels."""
    residual_window: int
    """Radius of the window in which a view's misfit is averaged, 0 to 15 px; 0 for the pixel alone."""
    floor: float
    """Grey levels², added to a window's variance so that textureless windows are not amplified."""
    noise_variance: float
    """Grey levels², of a pixel's noise in one image."""
    model_variance: float
    """Square of what normalised levels differ by without noise."""
    gate: float
    """Misfit q at which a view counts half; above it the view is not among the used ones."""


class NormalEquationsKernels(KernelFamily):
    """Kernel of least squares with one unknown per pixel."""

    def normal_equations(
        self,
        s: NDArray[np.floating],
        core: NDArray[np.floating],
        coefficients: Sequence[NDArray[np.floating]],
        views: NDArray[np.floating],
        *,
        window: int = 7,
        floor: float,
        noise_variance: float,
        model_variance: float,
        gate: float = 3.0,
        residual_window: int = 2,
        threads: int = 0,
    ) -> NormalEquations:
        """Return all views' Gauss-Newton equations for a change of s in each pixel; all 0 where s or the core is NaN.

        `NormalEquationsInput` describes the arguments. The core I and a view's warp J are normalised in a window,
        n = (value - mean) / √(variance + floor), so that gain and offset between cameras do not matter. With
        r = n_I - n_J, a view adds w (dn_J/ds)² to the information and w (dn_J/ds) r to the pull. The derivative of
        n_J holds the window's mean and variance constant. Cauchy's weight is w = 1 / (var(r) (1 + (q / gate)²)),
        where q is the mean of r² / var(r) about the pixel and
        var(r) = noise_variance (1 / (variance_I + floor) + 1 / (variance_J + floor)) + model_variance.

        Where a view does not see the surface, J is the core and the view adds nothing. Windows leave out pixels
        where the core is NaN; beyond the image they repeat its outermost pixels.

        References
        ----------
        Black & Anandan, Comput. Vis. Image Underst. 63(1), 75–104, 1996, doi:10.1006/cviu.1996.0006 (robust
        weights); Baker & Matthews, Int. J. Comput. Vis. 56(3), 221–255, 2004, doi:10.1023/B:VISI.0000011205.11775.fd.
        """
        s = float32("s", s, ("H", "W"))
        if not coefficients:
            raise KernelError("normal equations need at least one auxiliary")
        for name, radius, least in (("window", window, 1), ("residual_window", residual_window, 0)):
            if not least <= radius <= WINDOW_LIMIT:
                raise KernelError(f"{name} must be {least} to {WINDOW_LIMIT} px, not {radius}")
        for name, number in (("floor", floor), ("model_variance", model_variance), ("gate", gate)):
            demand_within(name, number, np.nextafter(0, 1), inf)
        demand_within("noise_variance", noise_variance, 0, inf)
        given = NormalEquationsInput(
            s, float32("core", core, s.shape), [spline(c) for c in coefficients],
            float32("views", views, (len(coefficients), PROJECTION_SIZE)), window, residual_window,
            floor, noise_variance, model_variance, gate,
        )  # fmt: skip
        out = np.empty_like(s), np.empty_like(s), np.empty(s.shape, np.uint8)
        return NormalEquations(*self._run("normal_equations", given, out, threads))
