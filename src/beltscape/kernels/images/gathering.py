"""Gathering: the values of planes at offsets from given pixels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.arrays import float32, pixel_indices
from beltscape.kernels.backend import KernelFamily


class GatherInput(NamedTuple):
    """Checked input of `gather`."""

    planes: list[NDArray[np.float32]]
    """P of (H, W)"""
    u: NDArray[np.float32]
    """(N,)"""
    v: NDArray[np.float32]
    """(N,)"""
    offsets: NDArray[np.int32]
    """(K, 2)"""


class GatheringKernels(KernelFamily):
    """Kernels that read planes at offsets from given pixels."""

    def gather(
        self,
        planes: Sequence[NDArray[np.floating]],
        u: NDArray[np.integer],
        v: NDArray[np.integer],
        offsets: NDArray[np.integer],
        *,
        threads: int = 0,
    ) -> NDArray[np.floating]:
        """Return the planes' values at (u + du, v + dv), or at the nearest pixel of their edge.

        Parameters
        ----------
        planes
            P of (H, W).
        u, v
            (N,) columns and rows.
        offsets
            (K, 2) du, dv.

        Returns
        -------
        (P, K, N) float32.
        """
        if not planes:
            raise KernelError("planes must be at least one")
        first = float32("planes[0]", planes[0], ("H", "W"))
        checked = [float32(f"planes[{i}]", plane, first.shape) for i, plane in enumerate(planes)]
        if offsets.ndim != 2 or offsets.shape[1] != 2 or offsets.dtype.kind not in "iu":
            raise KernelError(f"offsets must be (K, 2) integers, not {offsets.dtype} {offsets.shape}")
        given = GatherInput(
            checked, *pixel_indices(u, v, first.shape), np.ascontiguousarray(offsets, np.int32)
        )
        out = np.empty((len(checked) * len(offsets), len(given.u)), np.float32)
        (values,) = self._run("gather", given, (out,), threads)
        return values.reshape(len(checked), len(offsets), -1)
