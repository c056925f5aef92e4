"""Candidate propagation in C++."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.check_propagate import propagate_input
from beltscape.kernels.protocol.propagation import Propagated


class Propagation:
    """The kernel of native/bind_propagate.cpp."""

    _module: ModuleType

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
        """See `beltscape.kernels.protocol.propagation`."""
        numbers = {
            "separation": separation,
            "floor": floor,
            "unseen_cost": unseen_cost,
            "tolerance": tolerance,
            "small_jump": small_jump,
            "large_jump": large_jump,
        }
        given = propagate_input(
            s,
            slope_u,
            slope_v,
            core,
            images,
            views,
            buffers,
            offsets=offsets,
            candidates=candidates,
            numbers=numbers,
            active=active,
        )
        out = Propagated(*(np.empty_like(given.s) for _ in Propagated._fields))
        self._module.propagate(
            [given.s, given.slope_u, given.slope_v],
            given.core,
            given.images,
            given.views,
            given.buffers,
            given.offsets,
            candidates,
            list(numbers.values()),
            [] if given.active is None else [given.active],
            list(out),
            threads,
        )
        return out
