"""Kernels of numbers of whole planes, such as their quantiles, and of windows with weights.

A GPU computes them so that a frame's noise and texture need not be read by the processor, which would wait for it.
Their results without axes are numbers that stay on the GPU. Otherwise the processor's stages call OpenCV and NumPy
themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.core.statistics import compute_quantile
from beltscape.kernels.arrays import demand_within, float32
from beltscape.kernels.backend import KernelFamily
from beltscape.kernels.resident import ResidentArray

Floats = NDArray[np.floating]
Plane = NDArray[np.float32]


class FilterInput(NamedTuple):
    """Checked input of `filter_plane`."""

    plane: Plane
    """(H, W)"""
    weights: Plane
    """(h, w), both odd."""
    is_repeated: bool
    """Whether the outermost pixels are repeated beyond the edges, which else mirror."""


class QuantileInput(NamedTuple):
    """Checked input of `find_quantile`."""

    arrays: list[Plane]
    share: float


class MeanInput(NamedTuple):
    """Checked input of `average_plane`."""

    plane: Plane


class StatisticsKernels(KernelFamily):
    """Kernels of windows with weights and of numbers of whole planes."""

    def filter_plane(self, plane: Floats, weights: Floats, *, repeat_edge: bool = False) -> Plane:
        """Return (H, W) the sums over windows with ``weights`` (h, w), both odd.

        Beyond its edges the plane mirrors, or its outermost pixels are repeated.
        """
        checked = float32("weights", weights, ("h", "w"))
        if any(side % 2 == 0 for side in checked.shape):
            raise KernelError(f"weights must have odd sides, not {checked.shape}")
        given = FilterInput(float32("plane", plane, ("H", "W")), checked, repeat_edge)
        (found,) = self._run("filter_plane", given, (np.empty(given.plane.shape, np.float32),), 1)
        return found

    def find_quantile(self, arrays: Sequence[Floats], share: float) -> Plane:
        """Return () the quantile of all numbers but NaN, with linear interpolation; NaN where there is none."""
        if not arrays:
            raise KernelError("a quantile needs at least one array")
        demand_within("share", share, 0.0, 1.0)
        flat = [each.reshape(-1) for each in arrays]
        given = QuantileInput([float32(f"arrays[{i}]", each, ("N",)) for i, each in enumerate(flat)], share)
        (found,) = self._run("find_quantile", given, (np.empty((), np.float32),), 1)
        return found

    def average_plane(self, plane: Floats) -> Plane:
        """Return () the mean of the finite numbers (H, W); 0 where there is none."""
        given = MeanInput(float32("plane", plane, ("H", "W")))
        (found,) = self._run("average_plane", given, (np.empty((), np.float32),), 1)
        return found


def find_statistics_kernels(array: Any) -> StatisticsKernels | None:
    """Return the kernels of the GPU on which an array is; None for one of the processor."""
    if isinstance(array, ResidentArray) and array.operations is not None:
        return StatisticsKernels(cast("Any", array.operations))
    return None


def find_percentile(plane: Floats, percent: float) -> Any:
    """Return a percentile of the numbers of a plane (H, W): a number, on a GPU where the plane is."""
    kernels = find_statistics_kernels(plane)
    return (
        kernels.find_quantile([plane], percent / 100) if kernels else compute_quantile(plane, percent / 100)
    )
