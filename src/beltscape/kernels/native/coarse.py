"""`sweep`, `aggregate` and both at once in C++."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.bands import BAND_ROWS, HALO_ROWS
from beltscape.kernels.check_sweep import SweepInput, costs, jumps, sweep_input

SLAB_BYTES = 1 << 26
"""How many costs `coarse` holds at once."""


class Coarse:
    """The kernels of native/bind_coarse.cpp."""

    _module: ModuleType

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
        """See `beltscape.kernels.protocol.coarse`."""
        given = sweep_input(core, images, views, first, step, planes, floor, rows=rows, best=best)
        first_row, end_row = given.rows
        out = np.empty((end_row - first_row, given.core.shape[1], planes), np.uint8)
        self._module.sweep(*_arguments(given), first_row, out, threads)
        return out

    def aggregate(
        self, cost: NDArray[np.uint8], small_jump: int, large_jump: int
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """See `beltscape.kernels.protocol.coarse`."""
        cost = costs(cost)
        index, margin = np.empty(cost.shape[:2], np.float32), np.empty(cost.shape[:2], np.float32)
        self._module.aggregate(cost, *jumps(small_jump, large_jump), index, margin)
        return index, margin

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
        """See `beltscape.kernels.protocol.coarse`."""
        given = sweep_input(core, images, views, first, step, planes, floor, rows=None, best=best)
        index, margin = np.empty(given.core.shape, np.float32), np.empty(given.core.shape, np.float32)
        cut = BAND_ROWS, HALO_ROWS, _slab_rows(given)
        self._module.coarse(*_arguments(given), *jumps(small_jump, large_jump), *cut, index, margin, threads)
        return index, margin


def _slab_rows(given: SweepInput) -> int:
    """As many bands as keep the costs within SLAB_BYTES; which they are does not change the result."""
    return BAND_ROWS * max(1, SLAB_BYTES // (BAND_ROWS * given.core.shape[1] * given.planes))


def _arguments(given: SweepInput) -> tuple[object, ...]:
    return (
        given.core,
        given.images,
        given.views,
        given.first,
        given.step,
        given.planes,
        given.floor,
        given.best,
    )
