"""Kernels of windows over planes and of lists of pixels: what a matcher's features need between its other kernels.

The processor computes them with OpenCV and NumPy (`opencv_planes`), in every back end; a GPU has kernels of its
own. The functions below take a plane of either and compute it where it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.arrays import flags, float32
from beltscape.kernels.backend import KernelFamily
from beltscape.kernels.expressions import BlocksInput, ExpressionInput
from beltscape.kernels.resident import ResidentArray, to_processor

__all__ = [
    "PixelKernels",
    "PlaneKernels",
    "average_areas",
    "average_blocks",
    "blur",
    "dilate",
    "erode",
    "find_pixel_kernels",
    "find_plane_kernels",
    "interpolate_plane",
    "measure_distances",
    "measure_moments",
    "median_blur",
    "repeat_blocks",
    "to_processor",
    "to_single",
]

Floats = NDArray[np.floating]
Plane = NDArray[np.float32]
Size = tuple[int, int]
"""Width and height."""
Pixels = tuple[NDArray[Any], ...]
"""Rows and columns (N,) of some pixels; those of `list_pixels` are float32."""


class WindowInput(NamedTuple):
    """Checked input of `average_windows`, `measure_moments` and `find_extremes`."""

    plane: Plane
    """(H, W)"""
    size: Size
    """Odd width and height of the windows."""
    choice: bool
    """Means: whether the outermost pixels are repeated beyond the edges, which else mirror. Extremes: whether the
    largest value is meant, else the smallest; nothing lies beyond the edges."""


class PlaneInput(NamedTuple):
    """Checked input of `median_of_windows`, `average_areas` and `interpolate_plane`."""

    plane: Plane
    """(H, W)"""


class MaskInput(NamedTuple):
    """Checked input of `measure_distances` and `list_pixels`."""

    mask: NDArray[np.uint8]
    """(H, W)"""


class FoundPixels(NamedTuple):
    """The pixels of a mask, row by row, and their number, which the device knows first."""

    rows: Plane
    """(N,), as many as the mask has at most."""
    columns: Plane
    """(N,)"""
    count: NDArray[np.int32]
    """(1,)"""

    def cut(self) -> Pixels:
        """Return rows and columns as long as the list is, rounded up; the processor waits for the number."""
        length = round_up(int(self.count[0]))
        return self.rows[:length], self.columns[:length]


class PutInput(NamedTuple):
    """Checked input of `put_pixels`."""

    plane: Plane | ExpressionInput
    """(H, W), or on a GPU a program that gives it."""
    rows: Plane
    """(N,)"""
    columns: Plane
    """(N,)"""
    values: Plane
    """(N,)"""


class AddressInput(NamedTuple):
    """Checked input of `assign_addresses`."""

    rows: Plane
    """(N,) of the pixels that are numbered."""
    columns: Plane
    """(N,)"""
    accepted: NDArray[np.uint8]
    """(H, W)"""
    first: int


class BestInput(NamedTuple):
    """Checked input of `pick_best`."""

    scores: Plane
    """(C, N)"""
    planes: list[Plane]
    """K of (C, N)"""


class PlaneKernels(KernelFamily):
    """Kernels over the windows of a plane; they agree with OpenCV's functions."""

    def average_windows(self, plane: Floats, size: Size, *, repeat_edge: bool = False) -> Plane:
        """Return (H, W) the means in windows of odd (width, height); beyond its edges the plane (H, W) mirrors."""
        checked = _odd_windows(size)
        given = WindowInput(float32("plane", plane, ("H", "W")), checked, repeat_edge)
        return self._run_plane("average_windows", given, given.plane.shape)

    def measure_moments(self, plane: Floats, size: Size, *, repeat_edge: bool = False) -> tuple[Plane, Plane]:
        """Return (H, W) the means and the variances in the windows of `average_windows`."""
        given = WindowInput(float32("plane", plane, ("H", "W")), _odd_windows(size), repeat_edge)
        out = tuple(np.empty(given.plane.shape, np.float32) for _ in range(2))
        mean, variance = self._run("measure_moments", given, out, 1)
        return mean, variance

    def find_extremes(self, plane: Floats, size: Size, *, largest: bool) -> Plane:
        """Return (H, W) the largest or the smallest value in windows of odd (width, height)."""
        given = WindowInput(float32("plane", plane, ("H", "W")), _odd_windows(size), largest)
        return self._run_plane("find_extremes", given, given.plane.shape)

    def median_of_windows(self, plane: Floats) -> Plane:
        """Return (H, W) the medians of 5 × 5 pixels; beyond its edges the plane's outermost pixels are repeated."""
        given = PlaneInput(float32("plane", plane, ("H", "W")))
        return self._run_plane("median_of_windows", given, given.plane.shape)

    def measure_distances(self, mask: NDArray[Any]) -> Plane:
        """Return (H, W) the distance, px, to the nearest pixel of the mask (H, W); a GPU stops at 128 px.

        It is the length of the shortest path of steps along an axis (1), a diagonal (1.4) and a knight's (2.1969).
        """
        given = MaskInput(flags("mask", mask, mask.shape))
        return self._run_plane("measure_distances", given, mask.shape)

    def average_areas(self, plane: Floats, size: Size) -> Plane:
        """Return the plane on (height, width) fewer pixels, means over the area of each."""
        given = PlaneInput(float32("plane", plane, ("H", "W")))
        return self._run_plane("average_areas", given, size[::-1])

    def average_blocks(self, plane: Floats, side: int) -> Plane:
        """Return the means of the plane's whole blocks of ``side`` × ``side`` pixels."""
        given = BlocksInput(float32("plane", plane, ("H", "W")), side, 0)
        height, width = plane.shape
        return self._run_plane("average_blocks", given, (height // side, width // side))

    def repeat_blocks(self, plane: Floats, side: int, shape: tuple[int, ...]) -> Plane:
        """Return (H, W) every value repeated over its block; the last ones go on to the edges of ``shape``."""
        given = BlocksInput(float32("plane", plane, ("H", "W")), side, 0)
        return self._run_plane("repeat_blocks", given, shape)

    def subsample_plane(self, plane: Floats, first: int, step: int) -> Plane:
        """Return every ``step``-th value of every ``step``-th row, from ``first`` on in both."""
        given = BlocksInput(float32("plane", plane, ("H", "W")), step, first)
        height, width = (len(range(first, size, step)) for size in plane.shape)
        return self._run_plane("subsample_plane", given, (height, width))

    def interpolate_plane(self, plane: Floats, size: Size) -> Plane:
        """Return the plane on (height, width) more pixels, interpolated linearly."""
        given = PlaneInput(float32("plane", plane, ("H", "W")))
        return self._run_plane("interpolate_plane", given, size[::-1])

    def _run_plane(self, kernel: str, given: Any, shape: tuple[int, ...]) -> Plane:
        (found,) = self._run(kernel, given, (np.empty(shape, np.float32),), 1)
        return found


class PixelKernels(KernelFamily):
    """Kernels of lists of pixels, by their rows and columns as float32."""

    def list_pixels(self, mask: NDArray[Any]) -> Pixels:
        """Return rows and columns (N,) of the mask's pixels, row by row.

        On a GPU N is rounded up, by at most an eighth, and the first pixel repeated: lists of nearly one length go
        through one graph.
        """
        return self.find_pixels(mask).cut()

    def find_pixels(self, mask: NDArray[Any]) -> FoundPixels:
        """Return the pixels of `list_pixels`, whose number the processor need not know yet."""
        given = MaskInput(flags("mask", mask, mask.shape))
        out = *(np.empty(mask.size, np.float32) for _ in range(2)), np.empty(1, np.int32)
        return FoundPixels(*self._run("list_pixels", given, out, 1))

    def keep(self, array: NDArray[Any]) -> NDArray[Any]:
        """See `beltscape.kernels.Kernels.keep`."""
        keep: Callable[[NDArray[Any]], NDArray[Any]] | None = getattr(self.backend, "keep", None)
        return keep(array) if keep else array

    def put_pixels(self, plane: Floats, pixels: Pixels, values: Floats) -> Plane:
        """Return the plane (H, W) with other values (N,) at some pixels; the first counts if one is repeated."""
        rows, columns = pixels
        checked, base = float32("values", values, rows.shape), float32("plane", plane, ("H", "W"))
        program = base.find_program() if isinstance(base, ResidentArray) else None
        given = PutInput(program or base, rows, columns, checked)
        (found,) = self._run("put_pixels", given, (np.empty(plane.shape, np.float32),), 1)
        return found

    def assign_addresses(self, pixels: Pixels, accepted: NDArray[Any], first: int) -> NDArray[np.int32]:
        """Return (H, W) the numbers of some pixels, from ``first`` on, and of others 1 where accepted, else 0."""
        rows, columns = pixels
        given = AddressInput(rows, columns, flags("accepted", accepted, accepted.shape), first)
        (found,) = self._run("assign_addresses", given, (np.empty(accepted.shape, np.int32),), 1)
        return found

    def pick_best(self, scores: Floats, planes: Sequence[Floats]) -> Plane:
        """Return (K, N) the values in K planes (C, N) of each pixel's candidate with the largest score (C, N).

        Of equal scores the first counts.
        """
        checked = float32("scores", scores, ("C", "N"))
        given = BestInput(checked, [float32(f"planes[{i}]", p, checked.shape) for i, p in enumerate(planes)])
        out = np.empty((len(planes), checked.shape[1]), np.float32)
        (found,) = self._run("pick_best", given, (out,), 1)
        return found


def round_up(count: int) -> int:
    """Return the length of a list that holds ``count`` pixels: at most an eighth more, or 7."""
    unit = max(8, 1 << max(0, count.bit_length() - 4))
    return -(-count // unit) * unit


def _odd_windows(size: Size) -> Size:
    """Return the windows' size, or raise KernelError where a pixel is not in their middle."""
    if any(side < 1 or side % 2 == 0 for side in size):
        raise KernelError(f"windows must have odd sides, not {size[0]} × {size[1]}")
    return size


def find_plane_kernels(array: Any) -> PlaneKernels | None:
    """Return the kernels of the GPU on which an array is; None for one of the processor."""
    if isinstance(array, ResidentArray) and array.operations is not None:
        return PlaneKernels(cast("Any", array.operations))
    return None


def find_pixel_kernels(array: Any) -> PixelKernels | None:
    """Return the kernels of the GPU on which an array is; None for one of the processor."""
    if isinstance(array, ResidentArray) and array.operations is not None:
        return PixelKernels(cast("Any", array.operations))
    return None


def blur(plane: Floats, size: Size, *, repeat_edge: bool = False) -> Plane:
    """Return the means (H, W) in windows, see `PlaneKernels.average_windows`."""
    kernels = find_plane_kernels(plane)
    if kernels is None:
        return _on_processor().average_windows(WindowInput(cast("Plane", plane), size, repeat_edge))[0]
    return kernels.average_windows(plane, size, repeat_edge=repeat_edge)


def measure_moments(plane: Floats, size: Size, *, repeat_edge: bool = False) -> tuple[Plane, Plane]:
    """Return the means and variances (H, W) in windows, see `PlaneKernels.measure_moments`."""
    kernels = find_plane_kernels(plane)
    if kernels is None:
        return _on_processor().measure_moments(WindowInput(cast("Plane", plane), size, repeat_edge))
    return kernels.measure_moments(plane, size, repeat_edge=repeat_edge)


def dilate(plane: NDArray[Any], size: Size) -> NDArray[Any]:
    """Return the largest values (H, W) in windows, of the plane's own type."""
    return _find_extremes(plane, size, largest=True)


def erode(plane: NDArray[Any], size: Size) -> NDArray[Any]:
    """Return the smallest values (H, W) in windows, of the plane's own type."""
    return _find_extremes(plane, size, largest=False)


def _find_extremes(plane: NDArray[Any], size: Size, *, largest: bool) -> NDArray[Any]:
    kernels = find_plane_kernels(plane)
    if kernels is None:
        return _on_processor().extremes(plane, size, largest=largest)
    found = kernels.find_extremes(plane.astype(np.float32, copy=False), size, largest=largest)
    return found.astype(plane.dtype, copy=False)


def median_blur(plane: Floats) -> Plane:
    """Return the medians (H, W) of 5 × 5 pixels, see `PlaneKernels.median_of_windows`."""
    kernels = find_plane_kernels(plane)
    if kernels is None:
        return _on_processor().median_of_windows(PlaneInput(cast("Plane", plane)))[0]
    return kernels.median_of_windows(plane)


def measure_distances(mask: NDArray[Any]) -> Plane:
    """Return the distances (H, W) to a mask, see `PlaneKernels.measure_distances`."""
    kernels = find_plane_kernels(mask)
    if kernels is None:
        return _on_processor().measure_distances(MaskInput(mask))[0]
    return kernels.measure_distances(mask)


def average_areas(plane: Floats, size: Size) -> Plane:
    """Return a plane on fewer pixels, see `PlaneKernels.average_areas`."""
    kernels = find_plane_kernels(plane)
    if kernels is None:
        return _on_processor().average_areas(PlaneInput(cast("Plane", plane)), size)[0]
    return kernels.average_areas(plane, size)


def average_blocks(plane: Floats, side: int) -> Plane:
    """Return the means of a plane's whole blocks, see `PlaneKernels.average_blocks`."""
    kernels = find_plane_kernels(plane)
    if kernels is None:
        return _on_processor().average_blocks(BlocksInput(cast("Plane", plane), side, 0))[0]
    return kernels.average_blocks(plane, side)


def repeat_blocks(plane: Floats, side: int, shape: tuple[int, ...]) -> Plane:
    """Return a plane's values repeated over blocks, see `PlaneKernels.repeat_blocks`."""
    kernels = find_plane_kernels(plane)
    if kernels is None:
        return _on_processor().repeat_blocks(BlocksInput(cast("Plane", plane), side, 0), shape)[0]
    return kernels.repeat_blocks(plane, side, shape)


def interpolate_plane(plane: Floats, size: Size) -> Plane:
    """Return a plane on more pixels, see `PlaneKernels.interpolate_plane`."""
    kernels = find_plane_kernels(plane)
    if kernels is None:
        return _on_processor().interpolate_plane(PlaneInput(cast("Plane", plane)), size)[0]
    return kernels.interpolate_plane(plane, size)


def to_single(number: float) -> Any:
    """Return a number in single precision; one of a recorded graph is in it already."""
    return number if isinstance(number, ResidentArray) else np.float32(number)


def _on_processor() -> Any:
    from beltscape.kernels import opencv_planes  # imports OpenCV, which takes a while

    return opencv_planes
