"""The kernels in C++, one module per instruction-set level; the best one is chosen at import."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.check import triangulation_input

_ORDER = ("base", "v2", "v3", "v4")


def _module(level: str) -> ModuleType:
    return import_module(f"beltscape.kernels._native_{level}")


@cache
def levels() -> tuple[str, ...]:
    """Instruction-set levels that were built and that this processor runs, lowest first."""
    built = [level for level in _ORDER if find_spec(f"beltscape.kernels._native_{level}")]
    if not built:
        raise KernelError("the native kernels are not built; run: make install")
    best = _module(built[0]).cpu_level()
    return tuple(level for level in built if _ORDER.index(level) <= _ORDER.index(best))


class NativeKernels:
    """The kernels of one instruction-set level."""

    def __init__(self, level: str) -> None:
        self.name = level
        self._module = _module(level)

    def triangulate(
        self, projections: NDArray[np.float64], pixels: NDArray[np.float64], *, threads: int = 0
    ) -> NDArray[np.float64]:
        """See `beltscape.kernels.Kernels.triangulate`."""
        projections, pixels = triangulation_input(projections, pixels)
        out = np.empty((pixels.shape[1], 3))
        self._module.triangulate(projections, pixels, out, threads)
        return out
