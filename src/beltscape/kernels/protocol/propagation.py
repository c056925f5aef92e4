"""The protocol of candidate propagation: near depth steps, pixels take over their neighbours' surface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray


class Propagated(NamedTuple):
    """The chosen candidates; s, cost and margin are NaN where a pixel had none."""

    s: NDArray[np.floating]
    """(H, W) float32 nearness."""
    slope_u: NDArray[np.floating]
    """(H, W) float32, of the pixel that handed it; 0 where that was not finite."""
    slope_v: NDArray[np.floating]
    """(H, W) float32."""
    cost: NDArray[np.floating]
    """(H, W) float32 dissimilarity, 0 … 1."""
    margin: NDArray[np.floating]
    """(H, W) float32, how far the sum of the next candidate that differs by more than 1.5 lies above: at most 1."""


class Propagates(Protocol):
    """A surface whose pixels may change sides at a step."""

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
        """Every pixel's best candidate out of its own s and its surroundings', continued along their slopes.

        A pixel p has s itself as a candidate, and from every offset s_q + slope_q · (p - q), at most 3 from s_q,
        of q = p - offset (the nearest pixel of the grid to that). A view's dissimilarity over 3 × 3 pixels is
        that of `sweep`, each pixel of the window with its own candidate of the same offset. Those views count in
        which p is seen inside the image with nothing more than ``tolerance`` before it: their mean, from three
        on without the worst; ``unseen_cost`` where none does.

        Each pixel keeps the cheapest: a candidate nearer than ``separation`` to one that is kept takes its place
        if it is cheaper, any other that of the dearest if it is cheaper. Of these a semi-global choice on eight
        paths takes the one with the least sum of cost + mean of what the paths bring, where the step from
        candidate b of one pixel to candidate a of the next costs

            min(small_jump · |s_a - s_b - clamp((slope_a + slope_b) / 2 · step, -1, 1)|, large_jump).

        The grid is cut into bands of 128 rows; paths begin 12 rows outside of them.

        Parameters
        ----------
        s, slope_u, slope_v
            (H, W) nearness on the core's undistorted grid and its slopes per px. A pixel where s is NaN has no
            candidate of its own and hands on none; slopes that are not finite count as 0.
        core
            (H, W) grey levels, undistorted.
        images
            n of (h, w) grey levels, as the auxiliaries took them.
        views
            (n, 21) how each sees the core's pixels, rows as native/view.hpp lays them out.
        buffers
            n of (h, w) from `nearness_buffers`, of this or an earlier s.
        offsets
            (m, 2) integers dx, dy; at most 254.
        candidates
            How many a pixel keeps, 1 to 8.
        separation, tolerance
            In units of s.
        floor
            A variance in grey levels² below which texture counts as noise; positive.
        active
            (H, W) uint8 or bool; where it is 0 (or False) a pixel keeps its own. The work is in proportion to the
            16-pixel blocks with an active pixel. Left out, all are.

        References
        ----------
        Hirschmüller, IEEE TPAMI 30(2), 328–341, 2008, doi:10.1109/TPAMI.2007.1166 (the paths); Bleyer, Rhemann &
        Rother, PatchMatch Stereo, BMVC 2011, doi:10.5244/C.25.14 (planes handed on by neighbours).
        """
        ...
