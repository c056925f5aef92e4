"""Visibility: the part of the core's surface that an auxiliary sees."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.arrays import float32, image_sizes
from beltscape.kernels.backend import KernelFamily
from beltscape.kernels.projection import PROJECTION_SIZE


class BuffersInput(NamedTuple):
    """Checked input of `inverse_depth_buffers`."""

    s: NDArray[np.float32]
    """(H, W)"""
    views: NDArray[np.float32]
    """(n, 39)"""


class VisibleInput(NamedTuple):
    """Checked input of `visible`."""

    s: NDArray[np.float32]
    """(H, W)"""
    view: NDArray[np.float32]
    """(39,)"""
    buffer: NDArray[np.float32]
    """(h, w)"""
    tolerance: float


class VisibilityKernels(KernelFamily):
    """Kernels of inverse-depth buffers and of occlusion."""

    def inverse_depth_buffers(
        self,
        s: NDArray[np.floating],
        views: NDArray[np.floating],
        sizes: Sequence[tuple[int, int]],
        *,
        threads: int = 0,
    ) -> Sequence[NDArray[np.floating]]:
        """Return the largest inverse depth of the core's surface in each pixel of the auxiliaries.

        The inverse depth of every pixel of the core is written into the 2 × 2 pixels about its projection; the
        largest stays.

        Parameters
        ----------
        s
            (H, W) inverse depth on the core's undistorted grid; NaN where there is none.
        views
            (n, 39) how the auxiliaries see the core's pixels, rows as native/view.hpp lays them out.
        sizes
            n times (width, height) of an auxiliary's image.

        Returns
        -------
        n times (height, width) float32 inverse depth *seen from the auxiliary*, in units of s; 0 where there is none.
        """
        packed = float32("views", views, (len(sizes), PROJECTION_SIZE))
        given = BuffersInput(float32("s", s, ("H", "W")), packed)
        buffers = [np.empty((height, width), np.float32) for width, height in image_sizes(sizes)]
        return self._run("inverse_depth_buffers", given, buffers, threads)

    def visible(
        self,
        s: NDArray[np.floating],
        view: NDArray[np.floating],
        buffer: NDArray[np.floating],
        tolerance: float,
        *,
        threads: int = 0,
    ) -> NDArray[np.uint8]:
        """Return the mask of the core's pixels that an auxiliary sees.

        Parameters
        ----------
        s
            (H, W) inverse depth on the core's undistorted grid; NaN where there is none.
        view
            (39,) how the auxiliary sees the core's pixels.
        buffer
            (h, w) of this auxiliary, from `inverse_depth_buffers`.
        tolerance
            By how much, in units of s, the buffer at the auxiliary's nearest pixel (half is rounded up) may
            exceed the pixel's inverse depth without hiding it.

        Returns
        -------
        (H, W) uint8: 1 where it is seen, 0 where it is hidden, outside the image or where s is NaN.
        """
        given = VisibleInput(
            float32("s", s, ("H", "W")),
            float32("view", view, (PROJECTION_SIZE,)),
            float32("buffer", buffer, ("h", "w")),
            tolerance,
        )
        (visible,) = self._run("visible", given, (np.empty(given.s.shape, np.uint8),), threads)
        return visible
