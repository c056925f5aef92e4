"""Height rasterisation: a depth map's surface as an orthographic height map."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.arrays import float32
from beltscape.kernels.backend import KernelFamily

EDGE = 1e-9
"""Barycentric weight by which a node may lie outside a triangle, so that a node on a shared side lies in both; far
above the rounding of doubles (1e-16), far below a cell."""


class RasterisedHeights(NamedTuple):
    """The uppermost surface over each node of a grid; NaN where there is none."""

    height: NDArray[np.float64]
    """(Ny, Nx) in the units of the given transform's third row."""
    variance: NDArray[np.float64]
    """(Ny, Nx) of the depths there."""


class RasterisationInput(NamedTuple):
    """Checked input of `rasterise_heights`; the grid's shape is that of its results."""

    depth: NDArray[np.float32]
    """(H, W)"""
    sigma: NDArray[np.float32]
    """(H, W)"""
    use: NDArray[np.bool_]
    """(H, W)"""
    grid_from_pixel: NDArray[np.float64]
    """(3, 4)"""
    step: float


class HeightRasterisationKernels(KernelFamily):
    """Kernel of a depth map's heights over a grid."""

    def rasterise_heights(
        self,
        depth: NDArray[np.floating],
        sigma: NDArray[np.floating],
        use: NDArray[np.bool_],
        grid_from_pixel: NDArray[np.floating],
        step: float,
        shape: tuple[int, int],
        *,
        threads: int = 0,
    ) -> RasterisedHeights:
        """Return the top surface of a depth map at the nodes of a grid; it runs on one thread.

        Neighbouring pixels of one surface form triangles. A side connects two pixels whose depths differ by no more
        than ``step``, as float32. Of a square's two diagonals, the one from top right to bottom left is taken where
        it connects, else the other; a triangle exists where its three sides connect. At a node within a triangle, to
        `EDGE`, height and variance are interpolated linearly. Of several triangles the highest counts, and of equally
        high ones that with the largest variance. Vertical surfaces have no area, and overhangs are solid.

        Parameters
        ----------
        depth, sigma
            (H, W) and its standard deviation.
        use
            (H, W) bool: the pixels to use, where their positions, heights and variances are finite.
        grid_from_pixel
            (3, 4) a matrix A and a column b: pixel (u, v) of depth d lies at
            (column, row, height) = d A (u, v, 1) + b.
        step
            The largest difference of depth along a side, at least 0, in the units of the depth.
        shape
            (Ny, Nx) of the grid; nodes lie at whole columns and rows.

        Returns
        -------
        RasterisedHeights of (Ny, Nx).
        """
        del threads  # one is fast enough
        depth = float32("depth", depth, ("H", "W"))
        use = np.ascontiguousarray(use, dtype=bool)
        if use.shape != depth.shape:
            raise KernelError(f"use must have the shape {depth.shape}, not {use.shape}")
        grid_from_pixel = np.ascontiguousarray(grid_from_pixel, dtype=np.float64)
        if grid_from_pixel.shape != (3, 4):
            raise KernelError(f"grid_from_pixel must have the shape (3, 4), not {grid_from_pixel.shape}")
        if not step >= 0:
            raise KernelError(f"step must be at least 0, not {step}")
        if min(shape) < 1:
            raise KernelError(f"the grid's shape must be positive, not {shape}")
        sigma = float32("sigma", sigma, depth.shape)
        given = RasterisationInput(depth, sigma, use, grid_from_pixel, step)
        out = np.empty(shape), np.empty(shape)
        return RasterisedHeights(*self._run("rasterise_heights", given, out, 1))
