"""Kernels of selection: candidate surfaces of uncertain pixels, and the choice of a neighbour's surface.

Every candidate has its photo-consistency; by propagation a pixel near a depth step may take over the surface of a
neighbour.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.arrays import flags, float32, pixel_indices, sampled_images
from beltscape.kernels.backend import KernelFamily
from beltscape.kernels.projection import PROJECTION_SIZE
from beltscape.kernels.resident import ResidentArray

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


MOST_OFFSETS = 254
"""Largest number of offsets: their numbers, with that of the own surface, fit a byte in the native kernel."""
MOST_JUMP = 100
"""Largest cost of a step: with a candidate's cost, at most 1, far below the cost of an empty place (1000)."""
MOST_CANDIDATES = 8
"""Largest number of candidates of a pixel; the native kernel's arrays have this size."""
FARTHEST_OFFSET = 32767
"""Largest offset along an axis, px: wider than any image, and sums with a column fit 32 bits."""


class Propagated(NamedTuple):
    """The chosen candidates; s, cost and margin are NaN where a pixel had none."""

    s: NDArray[np.floating]
    """(H, W) float32 inverse depth."""
    slope_u: NDArray[np.floating]
    """(H, W) float32, of the pixel that it comes from; 0 where that was not finite."""
    slope_v: NDArray[np.floating]
    """(H, W) float32."""
    cost: NDArray[np.floating]
    """(H, W) float32 dissimilarity, 0 … 1."""
    margin: NDArray[np.floating]
    """(H, W) float32, how far the sum of the next candidate that differs by more than 1.5 lies above: at most 1."""


class PropagationCosts(NamedTuple):
    """The numbers that the choice depends on."""

    separation: float
    """Units of s: of candidates closer than this, a pixel keeps only the cheapest."""
    floor: float
    """A variance in grey levels² below which texture counts as noise; positive."""
    unseen_cost: float
    """The dissimilarity where no view sees the pixel, 0 … 1."""
    tolerance: float
    """Units of s: how much nearer than the pixel something in a buffer must lie to hide it."""
    small_jump: float
    """The cost of a step per unit of s that the slopes do not explain."""
    large_jump: float
    """The largest cost of a step, at most `MOST_JUMP`."""


class PropagationInput(NamedTuple):
    """Checked input of `propagate`."""

    surface: list[NDArray[np.float32]]
    """s, slope_u, slope_v, each (H, W): inverse depth on the core's undistorted grid and its slopes per px. A pixel
    where s is NaN has no candidate of its own and passes on none; slopes that are not finite count as 0."""
    core: NDArray[np.float32]
    """(H, W) grey levels, undistorted."""
    images: list[NDArray[np.float32]]
    """n of (h, w) grey levels, as the auxiliaries took them, each at least 2 × 2."""
    views: NDArray[np.float32]
    """(n, 39) packed projections of the core's pixels into the auxiliaries, as native/view.hpp lays them out."""
    buffers: list[NDArray[np.float32]]
    """n of (h, w) from `inverse_depth_buffers`, of this or an earlier s."""
    offsets: NDArray[np.int32]
    """(m, 2) dx, dy; at most 254."""
    candidates: int
    """How many candidates a pixel keeps, 1 to 8."""
    costs: PropagationCosts
    active: NDArray[np.uint8] | None
    """(H, W); where it is 0, a pixel keeps its own surface. The work is in proportion to the 16-pixel blocks with an
    active pixel. None where all pixels are active."""


class PropagationKernels(KernelFamily):
    """Kernels that choose between the surfaces on either side of a depth step."""

    def propagate(
        self,
        s: NDArray[np.floating],
        slope_u: NDArray[np.floating],
        slope_v: NDArray[np.floating],
        core: NDArray[np.floating],
        images: Sequence[NDArray[np.floating]],
        views: NDArray[np.floating],
        buffers: Sequence[NDArray[np.floating]],
        *,
        offsets: NDArray[np.integer],
        candidates: int = 5,
        separation: float = 0.4,
        floor: float,
        unseen_cost: float = 0.35,
        tolerance: float = 2.0,
        small_jump: float = 0.2,
        large_jump: float = 0.5,
        active: NDArray[np.uint8] | None = None,
        threads: int = 0,
    ) -> Propagated:
        """Return every pixel's best candidate: its own s, or that of a neighbour continued along its slopes.

        `PropagationInput` and `PropagationCosts` describe the arguments. From every offset a pixel p has the
        candidate s_q + slope_q · (p - q), at most 3 from s_q, of q = p - offset (or the grid's nearest pixel to it).
        A view's dissimilarity over 3 × 3 pixels is that of `sweep`, each pixel with its own candidate of the offset.
        The cost is the mean over the views that see p inside the image unoccluded, of three or more but the worst.

        A candidate replaces a kept one closer than ``separation``, or else the most expensive one, if it is cheaper.
        A semi-global selection on eight paths then takes the least sum of cost and the paths' mean cost. A step from
        candidate b of one pixel to candidate a of the next costs

            min(small_jump · |s_a - s_b - clamp((slope_a + slope_b) / 2 · step, -1, 1)|, large_jump).

        Paths begin 12 rows outside of bands of 128 rows.

        References
        ----------
        Hirschmüller, IEEE TPAMI 30(2), 328–341, 2008, doi:10.1109/TPAMI.2007.1166 (the paths); Bleyer, Rhemann &
        Rother, PatchMatch Stereo, BMVC 2011, doi:10.5244/C.25.14 (planes propagated to neighbours).
        """
        s = float32("s", s, ("H", "W"))
        images = _checked_images(images, buffers)
        if not 1 <= candidates <= MOST_CANDIDATES:
            raise KernelError(f"candidates must be 1 to {MOST_CANDIDATES}, not {candidates}")
        costs = PropagationCosts(separation, floor, unseen_cost, tolerance, small_jump, large_jump)
        _check_costs(costs)
        given = PropagationInput(
            surface=[s, float32("slope_u", slope_u, s.shape), float32("slope_v", slope_v, s.shape)],
            core=float32("core", core, s.shape),
            images=images,
            views=float32("views", views, (len(images), PROJECTION_SIZE)),
            buffers=[float32(f"buffers[{i}]", b, images[i].shape) for i, b in enumerate(buffers)],
            offsets=_checked_offsets(offsets),
            candidates=candidates,
            costs=costs,
            active=None if active is None else flags("active", active, s.shape),
        )
        out = [np.empty(s.shape, np.float32) for _ in Propagated._fields]
        return Propagated(*self._run("propagate", given, out, threads))


def _checked_images(
    images: Sequence[NDArray[np.floating]], buffers: Sequence[NDArray[np.floating]]
) -> list[NDArray[np.float32]]:
    """Return the auxiliaries' images, as many as buffers, or raise KernelError."""
    if not images:
        raise KernelError("propagation needs at least one auxiliary image")
    if len(buffers) != len(images):
        raise KernelError(f"buffers must be {len(images)}, as the images are, not {len(buffers)}")
    return sampled_images(images)


def _checked_offsets(offsets: NDArray[np.integer]) -> NDArray[np.int32]:
    """Return the offsets (m, 2) as int32, or raise KernelError."""
    offsets = np.asarray(offsets)
    if offsets.ndim != 2 or offsets.shape[1] != 2 or len(offsets) > MOST_OFFSETS:
        raise KernelError(
            f"offsets must have the shape (m, 2) with m of at most {MOST_OFFSETS}, not {offsets.shape}"
        )
    if not np.issubdtype(offsets.dtype, np.integer):
        raise KernelError(f"offsets must be integers, not {offsets.dtype}")
    if offsets.size and np.abs(offsets.astype(np.int64)).max() > FARTHEST_OFFSET:
        raise KernelError(f"offsets must be at most {FARTHEST_OFFSET} px, not {np.abs(offsets).max()}")
    return np.ascontiguousarray(offsets, dtype=np.int32)


def _check_costs(costs: PropagationCosts) -> None:
    """Raise KernelError when a number lies beyond its bounds."""
    for name, value in (("separation", costs.separation), ("floor", costs.floor)):
        if not (isinstance(value, ResidentArray) or 0 < value < np.inf):
            raise KernelError(f"{name} must be positive, not {value}")
    if not 0 <= costs.unseen_cost <= 1:
        raise KernelError(f"unseen_cost must be 0 to 1, not {costs.unseen_cost}")
    if not 0 <= costs.tolerance < np.inf:
        raise KernelError(f"tolerance must not be negative, not {costs.tolerance}")
    small, large = costs.small_jump, costs.large_jump
    if not (0 <= small < np.inf and 0 <= large <= MOST_JUMP):
        raise KernelError(
            f"jumps must be 0 <= small_jump and 0 <= large_jump <= {MOST_JUMP}, not {small} and {large}"
        )
