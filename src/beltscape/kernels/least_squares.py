"""Kernels of least squares: planes around every pixel, and the normal equations of a surface.

A plane is fitted over the largest window that agrees with the smallest; the normal equations give the change of
inverse depth that reduces the residuals of all views.
"""

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

RADII = ((3, 1.5), (5, 2.5), (8, 4.0))
"""Windows of a local fit: (radius px, Gaussian sigma px)."""
MOST_DISAGREEMENT = 25.0
"""Upper bound of the disagreement of two windows: five σ, squared; one of them does not describe the surface. Half
and double change nothing on a quarter-size heap."""
FIT_WINDOWS = 4
"""Largest number of windows that a fit chooses from; the native kernel's arrays have this size."""
TOLERANCES = (1e-3, 1e3)
"""Bounds of the tolerance in px: its eighth power must fit single precision (1e38)."""
LEAST_TAP = 0.01
"""The least tap of a window, as a share of the central one."""


class LocalFit(NamedTuple):
    """The planes; NaN (`scale`: 0) where s was not finite."""

    s: NDArray[np.floating]
    """(H, W) float32, at most 1 from what it was."""
    slope_u: NDArray[np.floating]
    """(H, W) float32, of s per px to the right."""
    slope_v: NDArray[np.floating]
    """(H, W) float32, of s per px downwards."""
    variance: NDArray[np.floating]
    """(H, W) float32, px², of s; infinite where the windows weigh nothing: nothing changes there."""
    disagreement: NDArray[np.floating]
    """(H, W) float32, squared difference of the values of the two largest windows over the smaller one's variance, at
    most `MOST_DISAGREEMENT`: about 0.5 where the surface is plane; 0 with one window."""
    scale: NDArray[np.uint8]
    """(H, W), the index of the radius that was taken."""


class FitWindow(NamedTuple):
    """A window of the local fit as the product of two Gaussians, with the taps below the least one left out."""

    radius: int
    taps: list[float]
    """radius + 1 by distance along an axis, px; 1 at the centre."""
    reach: list[int]
    """By a row's distance from the centre: the number of its taps to each side; -1 where it has no tap at all."""


class LocalFitInput(NamedTuple):
    """Checked input of `local_fit`."""

    information: NDArray[np.float32]
    """(H, W) from `normal_equations`, 1/px²; where it or the pull is not finite, both count as 0."""
    pull: NDArray[np.float32]
    """(H, W) from `normal_equations`, 1/px."""
    s: NDArray[np.float32]
    """(H, W) inverse depth; a pixel where it is not finite has no weight."""
    slope_u: NDArray[np.float32]
    """(H, W) of s per px to the right, of the planes so far; NaN counts as 0."""
    slope_v: NDArray[np.float32]
    """(H, W) of s per px downwards; NaN counts as 0."""
    windows: list[FitWindow]
    """One to four, from (radius px, Gaussian sigma px) with ascending radii of 1 to 15 px; sigmas may not fall."""
    tolerance: float
    """Of s in px, 0.001 to 1000."""
    confidence_width: float
    """Half the interval's width in standard deviations."""
    prior_information: float
    """1/px², the weight of every pixel's present s."""
    flatten: float
    """0 to 1: the share of e that the plane is fitted to, besides pull / information. With 0 the surface keeps its
    own shape, and moves only by what its neighbours' pulls have in common."""


class LocalFitKernels(KernelFamily):
    """Kernel of planes by weighted least squares."""

    def local_fit(
        self,
        information: NDArray[np.floating],
        pull: NDArray[np.floating],
        s: NDArray[np.floating],
        slope_u: NDArray[np.floating],
        slope_v: NDArray[np.floating],
        *,
        radii: Sequence[tuple[int, float]] = RADII,
        tolerance: float,
        confidence_width: float = 2.0,
        prior_information: float = 1.0,
        flatten: float = 1.0,
        threads: int = 0,
    ) -> LocalFit:
        """Fit a plane around each pixel p to s + pull / information of its neighbours q.

        `LocalFitInput` describes the arguments. q has the weight
        exp(-|q - p|² / 2σ²) (1 - (e / tolerance)²)₊² (information + prior_information), where
        e = s_q - s_p - slope · (q - p) is its distance from the plane so far: nothing is smoothed across a step. The
        prior does not add to the pull, so that a pixel without information is drawn only to its neighbours' s. Taps
        of the Gaussian below 0.01 are left out. A ridge of 0.1 px² times the window's weight draws the slopes to the
        earlier ones, which matters only where the window is narrow.

        The variance is that of the weighted mean, each q having 1 / (information + prior_information), and that of
        the plane's tilt from the weights' centre to p. The first window is taken, and each larger one as long as the
        confidence intervals (value ± confidence_width √variance) of all windows so far have a value in common.

        With information 1, pull 0, prior 0 and one radius the fit gives the slopes of a map.

        References
        ----------
        Katkovnik, IEEE Trans. Signal Process. 47(9), 2567–2571, 1999, doi:10.1109/78.782208 (intersection of
        confidence intervals); Goldenshluger & Nemirovski, Math. Methods Stat. 6(2), 135–170, 1997.
        """
        shape = float32("s", s, ("H", "W")).shape
        fields = {"information": information, "pull": pull, "s": s, "slope_u": slope_u, "slope_v": slope_v}
        checked = [float32(name, field, shape) for name, field in fields.items()]
        windows = fit_windows(radii)
        demand_within("tolerance", tolerance, *TOLERANCES)
        demand_within("confidence_width", confidence_width, 0, inf)
        demand_within("prior_information", prior_information, 0, inf)
        demand_within("flatten", flatten, 0, 1)
        given = LocalFitInput(
            *checked,
            windows=windows,
            tolerance=tolerance,
            confidence_width=confidence_width,
            prior_information=prior_information,
            flatten=flatten,
        )
        out = *(np.empty(shape, np.float32) for _ in range(5)), np.empty(shape, np.uint8)
        return LocalFit(*self._run("local_fit", given, out, threads))


def fit_windows(radii: Sequence[tuple[int, float]]) -> list[FitWindow]:
    """Return the windows of (radius px, Gaussian sigma px), ascending, or raise KernelError."""
    if not 1 <= len(radii) <= FIT_WINDOWS:
        raise KernelError(f"radii must be 1 to {FIT_WINDOWS} windows, not {len(radii)}")
    sizes = [radius for radius, _ in radii]
    if sorted(set(sizes)) != sizes or not 1 <= sizes[0] <= sizes[-1] <= WINDOW_LIMIT:
        raise KernelError(
            f"radii must ascend within 1 to {WINDOW_LIMIT} px, not {', '.join(map(str, sizes))}"
        )
    sigmas = [sigma for _, sigma in radii]
    if sorted(sigmas) != sigmas:  # a larger window has all taps of the smaller ones
        raise KernelError(
            f"the sigmas of larger windows must not be less, not {', '.join(f'{x:g}' for x in sigmas)}"
        )
    windows: list[FitWindow] = []
    for radius, sigma in radii:
        demand_within("a window's sigma", sigma, 1e-3, inf)
        taps = np.exp(-0.5 * (np.arange(radius + 1) / sigma) ** 2)
        reach = [int(np.count_nonzero(tap * taps >= LEAST_TAP)) - 1 for tap in taps]
        windows.append(FitWindow(radius, taps.tolist(), reach))
    return windows


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
        out = *(np.empty(s.shape, np.float32) for _ in range(2)), np.empty(s.shape, np.uint8)
        return NormalEquations(*self._run("normal_equations", given, out, threads))


FIT_ROUNDS = 8
"""Iterations of a shift's fit at most; Gauss-Newton from the best whole shift needs three to five."""
FIT_SETTLED = 1e-4
"""A shift's fit has converged where a round changes it by fewer cells."""
FIT_REACH = 3.0
"""A fit that moves farther than this from its start, cells, has diverged."""
FIT_CELLS = 100
"""Least number of cells in both fields: some blocks, so that the covariance can be estimated."""
FIT_REWEIGHTINGS = 3
"""Iterations of the weights within a round."""
FIT_BIWEIGHT = 4.7
"""Tukey's biweight ends at this multiple of the robust σ; as `core.statistics.TUKEY`, rounded."""
FIT_CONDITION = 1e12
"""Above this condition number the fields do not determine the shift."""
FIT_SAMPLES = 8192
"""Values at most of which a median is taken: every second, third … of more. A scale then scatters by 1 %."""


class ShiftInput(NamedTuple):
    """Checked input of `fit_shift`."""

    before: NDArray[np.float64]
    """(Ny, Nx)"""
    after: NDArray[np.float64]
    """(Ny, Nx)"""
    start: int
    side: int
    """Edge of a block of cells whose errors are one, cells."""


class FittedShift(NamedTuple):
    """The shift between two fields."""

    shift: NDArray[np.float64]
    """(2,) along rows and along columns, cells; NaN where the fields do not determine it."""
    variance: NDArray[np.float64]
    """(1,) of the shift along rows."""


class ShiftFitKernels(KernelFamily):
    """Kernel of the displacement of a field of heights."""

    def fit_shift(
        self, before: NDArray[np.floating], after: NDArray[np.floating], start: int, *, side: int
    ) -> FittedShift:
        """Return the shift by which ``after`` shows the heights of ``before``, refined from ``start`` whole rows.

        Both are (Ny, Nx), NaN where unknown. Each round displaces ``after``, interpolated bilinearly, and solves for
        a further shift along rows and columns and a difference of height, by robust least squares (Tukey's biweight)
        on the slopes of the fields' mean. The variance is a sandwich estimate over blocks of ``side`` cells, since
        errors of neighbouring cells are correlated.
        """
        before, after = (np.ascontiguousarray(field, np.float64) for field in (before, after))
        if before.ndim != 2 or min(before.shape) < 2:
            raise KernelError(f"before must have the shape (Ny, Nx) of 2 and more, not {before.shape}")
        if after.shape != before.shape:
            raise KernelError(f"after must have the shape {before.shape}, not {after.shape}")
        if side < 1:
            raise KernelError(f"side must be at least 1 cell, not {side}")
        given = ShiftInput(before, after, int(start), int(side))
        return FittedShift(*self._run("fit_shift", given, (np.empty(2), np.empty(1)), 1))
