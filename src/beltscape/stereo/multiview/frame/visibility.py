"""How many auxiliaries see a surface: inside their image, nothing in front."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels

OCCLUDER_PX = 2.0
"""How much nearer (px of disparity) something must lie in front of a pixel to hide it: more than a slope does."""


def count_visible_views(
    s: NDArray[np.floating],
    views: NDArray[np.float32],
    sizes: Sequence[tuple[int, int]],
    kernels: Kernels,
    threads: int = 0,
) -> NDArray[np.uint8]:
    """(H, W) how many of the auxiliaries see the surface of nearness s (H, W).

    ``views`` (n, 21) are how they see the grid, ``sizes`` their images' (width, height).
    """
    return compute_visibility(s, views, sizes, kernels, threads)[0]


def compute_visibility(
    s: NDArray[np.floating],
    views: NDArray[np.float32],
    sizes: Sequence[tuple[int, int]],
    kernels: Kernels,
    threads: int,
) -> tuple[NDArray[np.uint8], list[NDArray[np.floating]]]:
    """The same, and the buffers (h, w) of what lies nearest to each auxiliary by which it is told."""
    buffers = kernels.inverse_depth_buffers(s, views, sizes, threads=threads)
    seen = np.zeros(s.shape, np.uint8)
    for view, buffer in zip(views, buffers, strict=True):
        seen += kernels.visible(s, view, buffer, OCCLUDER_PX, threads=threads)
    return seen, list(buffers)
