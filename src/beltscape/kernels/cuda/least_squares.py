"""Plans of launches of warps, normal equations and local fits: native/cuda/least_squares.cuh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.cuda.device import Size, blocks_of
from beltscape.kernels.cuda.memory import DeviceArray
from beltscape.kernels.cuda.workspace import Workspace

MOST_VIEWS = 8
"""Views of one surface's normal equations (``kMostFitViews`` of least_squares.cuh)."""
TILE = 32, 8, 1
"""Threads of a block: a warp along the rows."""
_TAPS = 16
"""Taps of a window's half at most, with the central one (``kMaxRadius`` + 1)."""
_WINDOWS_BYTES = 4096
"""That hold the windows of a fit (``kFitWindowsBytes``)."""


def can_sum_equations(given: Any) -> bool:
    """Return whether the input is within the limits of the kernels."""
    return len(given.coefficients) <= MOST_VIEWS


def warp(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.images.WarpingKernels.warp`."""
    del out
    views, s = work.upload(given.view), work.upload(given.s)
    return list(_warp_view(work, views, 0, given.coefficients, s))


def normal_equations(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.least_squares.NormalEquationsKernels.normal_equations`."""
    padded = _PaddedPlanes(work, given.s.shape, max(given.window, given.residual_window))
    grey, there = padded.plane(), padded.plane()
    padded.launch("pad_core", work.upload(given.core), *padded.geometry, grey, there)
    floor = work.upload_number(given.floor)
    variances = map(work.upload_number, (given.noise_variance, given.model_variance))
    settings = given.window, floor, *variances
    core, part = _normalise_core(padded, given.window, floor, grey, there)

    s, views, count = work.upload(given.s), work.upload(given.views), len(given.coefficients)
    residuals = work.allocate((count, 4, *padded.shape), np.float32)
    misfits = work.allocate((count, *padded.shape), np.float32)
    for i, coefficients in enumerate(given.coefficients):
        warped = _warp_view(work, views, i, coefficients, s)
        value, slope = padded.plane(), padded.plane()
        padded.launch("pad_view", *warped, grey, there, *padded.geometry, value, slope)
        sums = padded.column_sums(value, given.window)
        fields = *core, part, there, value, slope, *sums
        padded.launch("view_residuals", *settings, *fields, *padded.geometry, residuals.part(i))
        misfit = residuals.part(i).part(3)
        padded.launch_columns(misfit, given.residual_window, misfits.part(i), padded.plane())

    there_sums, _ = padded.column_sums(there, given.residual_window)
    results = [work.allocate(array.shape, array.dtype) for array in out]
    weighed = given.residual_window, float(given.gate), residuals, misfits, count, there_sums
    work.launch("sum_equations", tile_grid(given.s.shape), TILE, *weighed, *padded.geometry, *results)
    return results


def local_fit(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.least_squares.LocalFitKernels.local_fit`."""
    del out
    height, width = given.s.shape
    margin = given.windows[-1].radius
    windows = _make_windows(work, given)
    s = work.upload(given.s)
    field = work.allocate((3, height + 2 * margin, width + 2 * margin), np.float32)
    geometry = width, height, margin
    pulled = work.upload(given.information), work.upload(given.pull), s
    work.launch(
        "make_field",
        tile_grid(field.shape[1:]),
        TILE,
        *pulled,
        float(given.prior_information),
        *geometry,
        field,
    )
    floats = work.allocate((5, height, width), np.float32)
    window = work.allocate((height, width), np.uint8)
    planes = s, work.upload(given.slope_u), work.upload(given.slope_v)
    work.launch(
        "fit_planes", tile_grid(given.s.shape), TILE, windows, field, *planes, *geometry, floats, window
    )
    return [*(floats.part(i) for i in range(5)), window]


@dataclass(frozen=True, slots=True)
class _PaddedPlanes:
    """Planes of an image's height and width, with a margin of repeated columns on either side."""

    work: Workspace
    image: tuple[int, int]
    margin: int

    @property
    def shape(self) -> tuple[int, int]:
        return self.image[0], self.image[1] + 2 * self.margin

    @property
    def geometry(self) -> tuple[int, int, int]:
        """Width, height and margin, as the kernels take them."""
        return self.image[1], self.image[0], self.margin

    def plane(self) -> Any:
        return self.work.allocate(self.shape, np.float32)

    def launch(self, kernel: str, *arguments: Any) -> None:
        self.work.launch(kernel, tile_grid(self.shape), TILE, *arguments)

    def launch_columns(self, plane: Any, radius: int, sums: Any, squares: Any) -> None:
        self.launch("sum_columns", plane, self.shape[1], self.shape[0], radius, sums, squares)

    def column_sums(self, plane: Any, radius: int) -> tuple[Any, Any]:
        """Return the sums over 2 radius + 1 rows of the values and of their squares."""
        sums, squares = self.plane(), self.plane()
        self.launch_columns(plane, radius, sums, squares)
        return sums, squares


def _normalise_core(
    padded: _PaddedPlanes, window: int, floor: Any, grey: Any, there: Any
) -> tuple[tuple[Any, Any], Any]:
    """Return the core's normalised value and scale, and one over the number of each window's pixels."""
    there_sums, _ = padded.column_sums(there, window)
    sums = padded.column_sums(grey, window)
    value, scale, part = padded.plane(), padded.plane(), padded.plane()
    fields = grey, there_sums, *sums
    padded.launch("normalise_core", window, floor, *fields, *padded.geometry, value, scale, part)
    return (value, scale), part


def _warp_view(
    work: Workspace, views: Any, i: int, coefficients: NDArray[np.float32], s: Any
) -> tuple[Any, Any]:
    """Return the value and the slope (H, W) of view ``i`` at the core's pixels with their inverse depth."""
    height, width = s.shape
    image = work.upload(coefficients), coefficients.shape[1], coefficients.shape[0]
    value, slope = (work.allocate((height, width), np.float32) for _ in range(2))
    work.launch("warp_view", tile_grid(s.shape), TILE, views, i, *image, s, width, height, value, slope)
    return value, slope


def _make_windows(work: Workspace, given: Any) -> Any:
    """Return the windows of a fit as the kernels hold them."""
    count = len(given.windows)
    taps, reach = np.zeros((count, _TAPS)), np.zeros((count, _TAPS), np.int32)
    for k, window in enumerate(given.windows):
        taps[k, : window.radius + 1], reach[k, : window.radius + 1] = window.taps, window.reach
    radii = np.array([window.radius for window in given.windows], np.int32)
    tolerance = np.array([given.tolerance, given.tolerance**4], np.float64)
    windows = work.allocate((_WINDOWS_BYTES,), np.uint8)
    arrays = work.upload(radii), work.upload(taps), work.upload(reach), count, work.upload(tolerance)
    settings = (float(each) for each in (given.confidence_width, given.prior_information, given.flatten))
    work.launch("make_windows", (1, 1, 1), (1, 1, 1), *arrays, *settings, windows)
    return windows


def tile_grid(shape: Sequence[int]) -> Size:
    """Return the blocks of `TILE` that cover (rows, columns)."""
    return blocks_of(shape[1], TILE[0]), blocks_of(shape[0], TILE[1]), 1
