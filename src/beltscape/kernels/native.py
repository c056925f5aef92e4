"""The native back end: kernels in C++, one module per instruction-set level; the best level is chosen at import."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.core.system_calls import count_usable_cores

_ORDER = ("scalar", "base", "v2", "v3", "v4")


def _module(level: str) -> ModuleType:
    return import_module(f"beltscape.kernels._native_{level}")


@cache
def levels() -> tuple[str, ...]:
    """Return the instruction-set levels that were built and that this processor runs, lowest first."""
    built = [level for level in _ORDER if find_spec(f"beltscape.kernels._native_{level}")]
    if not built:
        raise KernelError("the native kernels are not built; run: make install")
    best = _module(built[0]).cpu_level()
    return tuple(level for level in built if _ORDER.index(level) <= _ORDER.index(best))


def source_folder() -> Path:
    """Return the folder of the kernels' source that NVRTC compiles for a GPU; it lies beside the native modules."""
    return Path(str(_module(levels()[0]).__file__)).parent / "device_source"


class NativeBackend:
    """The kernels of one instruction-set level; native/bind.hpp reads a record's fields by their names."""

    def __init__(self, level: str) -> None:
        self.name = level
        self._module = _module(level)

    def run(
        self, kernel: str, given: Sequence[Any], out: Sequence[NDArray[Any]], threads: int
    ) -> Sequence[NDArray[Any]]:
        """See `beltscape.kernels.backend.Backend`."""
        function = getattr(self._module, kernel, None)
        if function is None:  # one of OpenCV's or NumPy's
            from beltscape.kernels import opencv_planes

            return opencv_planes.run(kernel, given, out)
        function(given, out, threads or count_usable_cores())
        return out
