"""Visibility of a surface in the auxiliaries: a point must project into the image, with nothing in front of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels
from beltscape.stereo.multiview.frame.frame import PreparedFrame

OCCLUDER_PX = 2.0
"""Distance (px of disparity) by which an occluder lies in front of a pixel: more than a slope accounts for."""


def count_visible_views(
    s: NDArray[np.floating],
    views: NDArray[np.float32],
    sizes: Sequence[tuple[int, int]],
    kernels: Kernels,
    threads: int = 0,
) -> NDArray[np.uint8]:
    """Return (H, W) the number of auxiliaries that see the surface of inverse depth s (H, W).

    ``views`` (n, 21) are the auxiliaries' packed projections, ``sizes`` their images' (width, height).
    """
    return _count_with_buffers(s, views, sizes, kernels, threads)[0]


def compute_visibility(
    s: NDArray[np.floating], prepared: PreparedFrame
) -> tuple[NDArray[np.uint8], list[NDArray[np.floating]]]:
    """Return (H, W) the number of auxiliaries that see s (H, W), and each auxiliary's inverse-depth buffer (h, w)."""
    context = prepared.context
    return _count_with_buffers(s, prepared.views, prepared.sizes, context.kernels, context.threads)


def _count_with_buffers(
    s: NDArray[np.floating],
    views: NDArray[np.float32],
    sizes: Sequence[tuple[int, int]],
    kernels: Kernels,
    threads: int,
) -> tuple[NDArray[np.uint8], list[NDArray[np.floating]]]:
    buffers = kernels.inverse_depth_buffers(s, views, sizes, threads=threads)
    count = np.zeros(s.shape, np.uint8)
    for view, buffer in zip(views, buffers, strict=True):
        count += kernels.visible(s, view, buffer, OCCLUDER_PX, threads=threads)
    return count, list(buffers)
