"""The protocol of occlusion: what of the core's surface an auxiliary sees."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Occludes(Protocol):
    """What lies nearest to an auxiliary, and what that hides."""

    def nearness_buffers(
        self,
        s: NDArray[np.floating],
        views: NDArray[np.floating],
        sizes: Sequence[tuple[int, int]],
        *,
        threads: int = 0,
    ) -> Sequence[NDArray[np.floating]]:
        """How near the core's surface comes to auxiliaries, in each of their pixels.

        The nearness of every pixel of the core is written into the 2 × 2 pixels about where it is seen; the
        largest stays.

        Parameters
        ----------
        s
            (H, W) nearness on the core's undistorted grid; NaN where there is none.
        views
            (n, 21) how the auxiliaries see the core's pixels, rows as native/view.hpp lays them out.
        sizes
            n times (width, height) of an auxiliary's image.

        Returns
        -------
        n times (height, width) float32 nearness *to the auxiliary*, in units of s; 0 where nothing lies.
        """
        ...

    def visible(
        self,
        s: NDArray[np.floating],
        view: NDArray[np.floating],
        buffer: NDArray[np.floating],
        tolerance: float,
        *,
        threads: int = 0,
    ) -> NDArray[np.uint8]:
        """Which of the core's pixels an auxiliary sees.

        Parameters
        ----------
        s
            (H, W) nearness on the core's undistorted grid; NaN where there is none.
        view
            (21,) how the auxiliary sees the core's pixels.
        buffer
            (h, w) of this auxiliary, from `nearness_buffers`.
        tolerance
            How much nearer, in units of s, something may lie at the auxiliary's nearest pixel (half is rounded
            up) without hiding the pixel.

        Returns
        -------
        (H, W) uint8: 1 where it is seen, 0 where it is hidden, outside the image or s is NaN.
        """
        ...
