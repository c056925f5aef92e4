"""Occlusion in C++."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.check import float32, image_sizes


class Occlusion:
    """The kernels of native/bind_occlusion.cpp."""

    _module: ModuleType

    def nearness_buffers(
        self,
        s: NDArray[np.floating],
        views: NDArray[np.floating],
        sizes: Sequence[tuple[int, int]],
        *,
        threads: int = 0,
    ) -> list[NDArray[np.float32]]:
        """See `beltscape.kernels.protocol.occlusion`."""
        s = float32("s", s, ("H", "W"))
        views = float32("views", views, (len(sizes), 21))
        buffers = [np.zeros((h, w), np.float32) for w, h in image_sizes(sizes)]
        self._module.nearness_buffers(s, list(views), buffers, threads)
        return buffers

    def visible(
        self,
        s: NDArray[np.floating],
        view: NDArray[np.floating],
        buffer: NDArray[np.floating],
        tolerance: float,
        *,
        threads: int = 0,
    ) -> NDArray[np.uint8]:
        """See `beltscape.kernels.protocol.occlusion`."""
        s, view = float32("s", s, ("H", "W")), float32("view", view, (21,))
        buffer = float32("buffer", buffer, ("h", "w"))
        out = np.empty(s.shape, np.uint8)
        self._module.visible(s, view, buffer, tolerance, out, threads)
        return out
