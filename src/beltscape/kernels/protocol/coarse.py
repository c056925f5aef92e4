"""The protocol of the coarse search: a plane sweep and its semi-global aggregation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Searches(Protocol):
    """The plane of every core pixel, by all auxiliaries at once."""

    def sweep(
        self,
        core: NDArray[np.float32],
        images: Sequence[NDArray[np.float32]],
        views: NDArray[np.float32],
        first: float,
        step: float,
        planes: int,
        floor: float,
        *,
        rows: tuple[int, int] | None = None,
        best: int = 2,
        threads: int = 0,
    ) -> NDArray[np.uint8]:
        """How badly the auxiliaries agree with the core on every plane of nearness.

        Windows of 3 × 3 pixels of the core's grid (its border repeated) are compared by

            c = Σ((I-Ī) - (J-J̄))² / (Σ(I-Ī)² + Σ(J-J̄)² + 18 floor),  at most 1,

        with I the core and J an auxiliary sampled bilinearly where it sees the plane; c = 1 where one of the
        window's samples has no 2 × 2 footprint in the auxiliary or is NaN. The ``best`` smallest are averaged.

        Parameters
        ----------
        core
            (H, W) grey levels, undistorted.
        images
            n of (h, w) grey levels, as the auxiliaries took them.
        views
            (n, 21) how each sees the core's pixels: `beltscape.kernels.reference.view.see`.
        first, step, planes
            Plane d has the nearness first + step · d; 4 to 4096 planes.
        floor
            A variance in grey levels² below which texture counts as noise; positive.
        rows
            First row and the one after the last; all when left out.
        best
            How many views are averaged; all where there are fewer.

        Returns
        -------
        (rows, W, planes) uint8: 120 c, rounded.
        """
        ...

    def aggregate(
        self, cost: NDArray[np.uint8], small_jump: int, large_jump: int
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The plane of every pixel by semi-global aggregation over eight paths; one thread.

        Parameters
        ----------
        cost
            (rows, W, D) of at most 120 (more counts as 120), 4 ≤ D ≤ 4096.
        small_jump, large_jump
            Price of a step of one plane, and of more: 0 ≤ small ≤ large ≤ 8000. Up to small + large = 135
            and large = 127 it works in bytes instead of 16 bits.

        Returns
        -------
        (rows, W) plane of the least sum (the first of equals), to a part of a plane by the symmetric V
        through it and its neighbours; (rows, W) margin, 0 … : how far the least sum of the planes that are not its
        neighbours lies above, as a mean dissimilarity of a path.

        References
        ----------
        Hirschmüller, TPAMI 30(2), 2008, doi:10.1109/TPAMI.2007.1166.
        """
        ...

    def coarse(  # noqa: PLR0917 (its parts take the same in the same order)
        self,
        core: NDArray[np.float32],
        images: Sequence[NDArray[np.float32]],
        views: NDArray[np.float32],
        first: float,
        step: float,
        planes: int,
        floor: float,
        small_jump: int,
        large_jump: int,
        *,
        best: int = 2,
        threads: int = 0,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """`sweep` and `aggregate` at once, in bands of rows that overlap.

        The result is that of both over each of `beltscape.kernels.bands.bands`, of which the middle is kept. It
        holds up to 64 MB of costs and, for each thread, twice as many bytes as a band of 64 rows has costs.

        Returns
        -------
        (H, W) plane and (H, W) margin, as from `aggregate`.
        """
        ...
