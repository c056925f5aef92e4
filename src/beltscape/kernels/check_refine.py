"""What the joint least squares are given, checked once at the wrapper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.check import float32, spline

WINDOW_LIMIT = 15
"""The largest radius of a window, px."""
FIT_WINDOWS = 4
"""How many windows a fit may choose from."""
TOLERANCES = (1e-3, 1e3)
"""Of s, px: its eighth power must fit single precision."""


@dataclass(frozen=True, slots=True, eq=False)
class NormalInput:
    """The input of `normal_equations`."""

    s: NDArray[np.float32]
    """(H, W) nearness; NaN where there is none."""
    core: NDArray[np.float32]
    """(H, W) grey levels; NaN where there are none."""
    coefficients: list[NDArray[np.float32]]
    """n of (h, w)."""
    views: NDArray[np.float32]
    """(n, 21), rows as native/view.hpp lays them out."""
    window: int
    """Radius of the normalisation's window, px."""
    residual_window: int
    """Radius of the window that judges a view, px; 0 for the pixel alone."""
    floor: float
    """Grey levels², added to a window's variance."""
    noise_variance: float
    """Of an image, grey levels²."""
    model_variance: float
    """Of normalised grey levels."""
    gate: float
    """Of the root mean square residual, in standard deviations."""


def normal_input(
    s: NDArray[np.floating],
    core: NDArray[np.floating],
    coefficients: Sequence[NDArray[np.floating]],
    views: NDArray[np.floating],
    *,
    window: int,
    residual_window: int,
    **numbers: float,
) -> NormalInput:
    """The input of `normal_equations` as the kernels take it, or KernelError."""
    s = float32("s", s, ("H", "W"))
    if not coefficients:
        raise KernelError("normal equations need at least one auxiliary")
    for name, radius, least in (("window", window, 1), ("residual_window", residual_window, 0)):
        if not least <= radius <= WINDOW_LIMIT:
            raise KernelError(f"{name} must be {least} to {WINDOW_LIMIT} px, not {radius}")
    for name in ("floor", "model_variance", "gate"):
        _within(name, numbers[name], np.nextafter(0, 1), inf)
    _within("noise_variance", numbers["noise_variance"], 0, inf)
    return NormalInput(
        s, float32("core", core, s.shape), [spline(c) for c in coefficients],
        float32("views", views, (len(coefficients), 21)), window, residual_window, **numbers,
    )  # fmt: skip


class FitWindow(NamedTuple):
    """A window of the local fit as the product of two Gaussians, with the taps below the least one left out."""

    radius: int
    taps: NDArray[np.float64]
    """(radius + 1,) by distance along an axis, px; 1 at the centre."""
    reach: list[int]
    """By a row's distance from the centre: how many taps it has to each side; -1 where not even a centre."""


LEAST_TAP = 0.01
"""Of the central one."""


def fit_windows(radii: Sequence[tuple[int, float]]) -> list[FitWindow]:
    """The windows of (radius px, Gaussian sigma px), ascending, or KernelError."""
    if not 1 <= len(radii) <= FIT_WINDOWS:
        raise KernelError(f"radii must be 1 to {FIT_WINDOWS} windows, not {len(radii)}")
    sizes = [radius for radius, _ in radii]
    if sorted(set(sizes)) != sizes or not 1 <= sizes[0] <= sizes[-1] <= WINDOW_LIMIT:
        raise KernelError(
            f"radii must ascend within 1 to {WINDOW_LIMIT} px, not {', '.join(map(str, sizes))}"
        )
    windows = []
    for radius, sigma in radii:
        _within("a window's sigma", sigma, 1e-3, inf)
        taps = np.exp(-0.5 * (np.arange(radius + 1) / sigma) ** 2)
        reach = [int(np.count_nonzero(tap * taps >= LEAST_TAP)) - 1 for tap in taps]
        windows.append(FitWindow(radius, taps, reach))
    return windows


@dataclass(frozen=True, slots=True, eq=False)
class FitInput:
    """The input of `local_fit`."""

    fields: tuple[NDArray[np.float32], ...]
    """Information, pull, s, slope_u, slope_v, each (H, W)."""
    windows: list[FitWindow]
    tolerance: float
    confidence_width: float
    prior_information: float
    flatten: float


def fit_input(
    fields: dict[str, NDArray[np.floating]],
    radii: Sequence[tuple[int, float]],
    tolerance: float,
    confidence_width: float,
    prior_information: float,
    flatten: float,
) -> FitInput:
    """The input of `local_fit` as the kernels take it, or KernelError."""
    shape = float32("s", fields["s"], ("H", "W")).shape
    checked = tuple(float32(name, field, shape) for name, field in fields.items())
    windows = fit_windows(radii)
    _within("tolerance", tolerance, *TOLERANCES)
    _within("confidence_width", confidence_width, 0, inf)
    _within("prior_information", prior_information, 0, inf)
    _within("flatten", flatten, 0, 1)
    return FitInput(checked, windows, tolerance, confidence_width, prior_information, flatten)


def _within(name: str, number: float, low: float, high: float) -> None:
    """KernelError when a number is not finite or not in its bounds."""
    if not (np.isfinite(number) and low <= number <= high):
        bounds = "positive" if low < 1e-300 and low else f"at least {low:g}"
        bounds += "" if high == inf else f" and at most {high:g}"
        raise KernelError(f"{name} must be {bounds}, not {number:g}")
