"""Kernels of geometry: triangulation, visibility, height rasterisation, and the fusion of layers.

Points are triangulated from their pixels in several cameras; visibility is that of the core's surface from an
auxiliary; a depth map's surface becomes an orthographic height map; layers that show one surface are fused.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.arrays import float32, image_sizes
from beltscape.kernels.backend import KernelFamily
from beltscape.kernels.projection import PROJECTION_SIZE


class TriangulationInput(NamedTuple):
    """Checked input of `triangulate`."""

    projections: NDArray[np.float64]
    """(n, 3, 4)"""
    pixels: NDArray[np.float64]
    """(n, N, 2)"""


class TriangulationKernels(KernelFamily):
    """Kernel of points from rays."""

    def triangulate(
        self, projections: NDArray[np.floating], pixels: NDArray[np.floating], *, threads: int = 0
    ) -> NDArray[np.float64]:
        """Return N points seen by any subset of n cameras, in the least-squares sense.

        Parameters
        ----------
        projections
            (n, 3, 4) projection matrices, frame in mm → undistorted pixels.
        pixels
            (n, N, 2) undistorted pixels; NaN where a camera does not see the point.
        threads
            How many threads; 0 takes all cores. The result does not depend on it.

        Returns
        -------
        (N, 3) points in mm; NaN where fewer than two cameras see a point or their rays are parallel.

        Raises
        ------
        KernelError
            When the shapes do not fit each other.

        References
        ----------
        Hou, Kang & Qiao, Sensors 2025, 25(7), 2111, doi:10.3390/s25072111, Eqs. 2-3.
        """
        given = _checked(projections, pixels)
        (points,) = self._run("triangulate", given, (np.empty((given.pixels.shape[1], 3)),), threads)
        return points


def _checked(projections: NDArray[np.floating], pixels: NDArray[np.floating]) -> TriangulationInput:
    """Return contiguous float64 (n, 3, 4) projections and (n, N, 2) pixels, or raise KernelError."""
    projections = np.ascontiguousarray(projections, dtype=np.float64)
    pixels = np.ascontiguousarray(pixels, dtype=np.float64)
    if projections.ndim != 3 or projections.shape[1:] != (3, 4):
        raise KernelError(f"projections must have the shape (n, 3, 4), not {projections.shape}")
    if pixels.ndim != 3 or pixels.shape[2] != 2 or pixels.shape[0] != projections.shape[0]:
        raise KernelError(
            f"pixels must have the shape ({projections.shape[0]}, N, 2) for {projections.shape[0]} cameras, "
            f"not {pixels.shape}"
        )
    return TriangulationInput(projections, pixels)


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


LEAST_LAYER_SIGMA, LEAST_FREEDOM = 1e-4, 1e-6
"""Least σ of a layer's cell, and least share of a deviation from the mean that the mean leaves: both only keep
divisions finite."""


class LayersInput(NamedTuple):
    """Checked input of `fuse_layers`."""

    height: NDArray[np.float32]
    """(k, n, m)"""
    sigma: NDArray[np.float32]
    """(k, n, m)"""
    noise: NDArray[np.float32]
    """(k, n, m)"""
    rank: float
    outlier: float
    tolerance: float


class FusedLayers(NamedTuple):
    """Cells (n, m) fused from k layers."""

    height: NDArray[np.float32]
    """Mean of the values that agree, weighted by 1/σ²; NaN where there is none."""
    sigma: NDArray[np.float32]
    """σ of the mean for independent errors."""
    noise: NDArray[np.float32]
    """The same for the layers' ``noise``."""
    measured: NDArray[np.uint8]
    """Whether any layer measured the cell."""
    sums: NDArray[np.float64]
    """(n, 5) over the cells of a row in which two values or more agree: number of these values; their squared
    deviations from the mean over the share that the mean leaves of them; their σ²; their number times the sum of
    squared weights over the squared sum; and, over all cells, the number of values that do not agree."""


class LayerFusionKernels(KernelFamily):
    """Kernel of the fusion of layers that show one surface."""

    def fuse_layers(
        self,
        planes: tuple[NDArray[np.floating], NDArray[np.floating], NDArray[np.floating]],
        *,
        rank: float,
        outlier: float,
        tolerance: float,
        threads: int = 0,
    ) -> FusedLayers:
        """Return the surface that layers of heights have in common.

        Each cell's values are ranked; the first at which the weights 1/σ² reach the share ``rank`` of their sum is
        the middle. Values agree that differ from it by no more than ``outlier`` σ and ``tolerance`` times the
        surface's rise per cell, which is that of the middles (0 where it is not known).

        Parameters
        ----------
        planes
            (k, n, m) heights, NaN where not measured, with their σ and the part of it that neighbours share.
        rank, outlier, tolerance
            See above.
        threads
            How many threads; 0 takes all cores. The result does not depend on it.
        """
        height = float32("height", planes[0], ("k", "n", "m"))
        sigma, noise = (
            float32(name, plane, height.shape)
            for name, plane in zip(("sigma", "noise"), planes[1:], strict=True)
        )
        given = LayersInput(height, sigma, noise, float(rank), float(outlier), float(tolerance))
        shape = height.shape[1:]
        out = (
            *(np.empty(shape, np.float32) for _ in range(3)),
            np.empty(shape, np.uint8),
            np.empty((shape[0], 5)),
        )
        return FusedLayers(*self._run("fuse_layers", given, out, threads))
