"""Candidate surfaces of uncertain pixels, and the photo-consistency of each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.arrays import flags, float32, pixel_indices, sampled_images
from beltscape.kernels.backend import KernelFamily
from beltscape.kernels.projection import PROJECTION_SIZE

CANDIDATES = 9
"""Number of a pixel's candidates: its own surface, then one from each of eight directions."""
MOST_REACH = 1000
"""Largest number of steps to a candidate, which bounds the search; the matcher uses far fewer."""


class Candidates(NamedTuple):
    """Candidate surfaces of N pixels, a row each; NaN where a direction has none."""

    s: NDArray[np.floating]
    """(9, N) float32 inverse depth at the pixel; the first row is its own."""
    slope_u: NDArray[np.floating]
    """(9, N) float32."""
    slope_v: NDArray[np.floating]
    """(9, N) float32."""
    distance: NDArray[np.floating]
    """(9, N) float32, steps to the pixel that it comes from."""
    support: NDArray[np.floating]
    """(9, N) float32, the sum of 1 / (1 + distance) of the other directions' candidates that agree with it."""


class PhotoConsistency(NamedTuple):
    """Squared differences of levels over their variance.

    ``point`` is at the pixel, ``cross`` the mean of the pixel and the four beside it. ``least``, ``second``, ``mean``
    and ``most`` are taken over the views that see the point; they are at most 50, and 50 where no view sees it.
    """

    point_least: NDArray[np.floating]
    """(C, N) float32, as all of these."""
    point_second: NDArray[np.floating]
    """The least where only one view sees it."""
    point_mean: NDArray[np.floating]
    point_most: NDArray[np.floating]
    cross_least: NDArray[np.floating]
    cross_second: NDArray[np.floating]
    cross_mean: NDArray[np.floating]
    cross_most: NDArray[np.floating]
    views: NDArray[np.floating]
    """Number of views that see the point."""


class CandidatesInput(NamedTuple):
    """Checked input of `candidate_surfaces`."""

    surface: list[NDArray[np.float32]]
    """s, slope_u, slope_v, each (H, W)."""
    reliable: NDArray[np.uint8]
    """(H, W)"""
    u: NDArray[np.float32]
    """(N,) columns."""
    v: NDArray[np.float32]
    """(N,) rows."""
    reach: int
    """Steps, along a row, a column or a diagonal."""
    separation: float
    """Units of s."""


class PhotoConsistencyInput(NamedTuple):
    """Checked input of `photo_consistency`."""

    u: NDArray[np.float32]
    """(N,) columns, within the grid."""
    v: NDArray[np.float32]
    """(N,) rows, within the grid."""
    planes: list[NDArray[np.float32]]
    """s, slope_u, slope_v, each (C, N); no view sees a plane where s is NaN."""
    core: NDArray[np.float32]
    """(H, W) grey levels."""
    variance: NDArray[np.float32]
    """(H, W), of the difference of a core's level from an auxiliary's, levels²."""
    images: list[NDArray[np.float32]]
    """n of (h, w), as in `propagate`."""
    views: NDArray[np.float32]
    """(n, 39), as in `propagate`."""
    buffers: list[NDArray[np.float32]]
    """n of (h, w), as in `propagate`."""
    gains: list[NDArray[np.float32]]
    """n of (H, W): an auxiliary's levels times this are the core's."""
    tolerance: float
    """Units of s: how much nearer than the plane something in a buffer must lie to hide it."""


class CandidateKernels(KernelFamily):
    """Candidate surfaces for uncertain pixels, and how well each agrees with the images."""

    def candidate_surfaces(
        self,
        s: NDArray[np.floating],
        slope_u: NDArray[np.floating],
        slope_v: NDArray[np.floating],
        reliable: NDArray[np.uint8],
        u: NDArray[np.integer],
        v: NDArray[np.integer],
        *,
        reach: int,
        separation: float,
        threads: int = 0,
    ) -> Candidates:
        """Return the surfaces that N pixels (u, v) may have.

        Each of eight directions (upper left, above, upper right, left, …) gives the plane of its first reliable pixel
        with a finite s within ``reach`` steps, with slopes limited to ±1.5. Slopes that are not finite count as 0. A
        step along a diagonal is one pixel across and one down.

        Parameters
        ----------
        s, slope_u, slope_v
            (H, W) inverse depth and its slopes per px.
        reliable
            (H, W) uint8 or bool; where it is 0, a pixel gives no candidate.
        u, v
            (N,) columns and rows, within the grid.
        separation
            Candidates closer than this in s agree.
        """
        s = float32("s", s, ("H", "W"))
        if not 1 <= reach <= MOST_REACH:
            raise KernelError(f"reach must be 1 to {MOST_REACH} steps, not {reach}")
        if not 0 < separation < np.inf:
            raise KernelError(f"separation must be positive, not {separation}")
        surface = [s, float32("slope_u", slope_u, s.shape), float32("slope_v", slope_v, s.shape)]
        pixels = pixel_indices(u, v, s.shape)
        given = CandidatesInput(surface, flags("reliable", reliable, s.shape), *pixels, reach, separation)
        out = [np.empty((CANDIDATES, len(given.u)), np.float32) for _ in Candidates._fields]
        return Candidates(*self._run("candidate_surfaces", given, out, threads))

    def photo_consistency(
        self,
        u: NDArray[np.integer],
        v: NDArray[np.integer],
        s: NDArray[np.floating],
        slope_u: NDArray[np.floating],
        slope_v: NDArray[np.floating],
        *,
        core: NDArray[np.floating],
        variance: NDArray[np.floating],
        images: Sequence[NDArray[np.floating]],
        views: NDArray[np.floating],
        buffers: Sequence[NDArray[np.floating]],
        gains: Sequence[NDArray[np.floating]],
        tolerance: float,
        threads: int = 0,
    ) -> PhotoConsistency:
        """Return how well the auxiliaries' levels agree with the core's on C small planes at each of N pixels.

        `PhotoConsistencyInput` describes the arguments. The difference of a level from the core's is
        (I - gain · J)² / variance, with the gain of the pixel and J sampled bilinearly where the auxiliary sees the
        plane. Beyond the core's edge its outermost pixels are repeated.
        """
        core = float32("core", core, ("H", "W"))
        columns, rows = pixel_indices(u, v, core.shape)
        first = float32("s", s, ("C", len(columns)))
        images = sampled_images(images)
        for name, arrays in (("buffers", buffers), ("gains", gains)):
            if len(arrays) != len(images):
                raise KernelError(f"{name} must be {len(images)}, as the images are, not {len(arrays)}")
        if not 0 <= tolerance < np.inf:
            raise KernelError(f"tolerance must not be negative, not {tolerance}")
        given = PhotoConsistencyInput(
            columns,
            rows,
            [first, *(float32("slopes", plane, first.shape) for plane in (slope_u, slope_v))],
            core,
            float32("variance", variance, core.shape),
            images,
            float32("views", views, (len(images), PROJECTION_SIZE)),
            [float32(f"buffers[{i}]", b, images[i].shape) for i, b in enumerate(buffers)],
            [float32(f"gains[{i}]", gain, core.shape) for i, gain in enumerate(gains)],
            tolerance,
        )
        out = np.empty((len(PhotoConsistency._fields) * len(first), len(columns)), np.float32)
        (rows_of_all,) = self._run("photo_consistency", given, (out,), threads)
        return PhotoConsistency(*rows_of_all.reshape(-1, *first.shape))
