"""The kernels in C++, one module per instruction-set level; the best one is chosen at import. A family a file."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

from beltscape.core.errors import KernelError
from beltscape.kernels.native.coarse import Coarse
from beltscape.kernels.native.hear import Messages
from beltscape.kernels.native.neighbours import Neighbourhood
from beltscape.kernels.native.occlusion import Occlusion
from beltscape.kernels.native.perceptron import Perceptron
from beltscape.kernels.native.propagation import Propagation
from beltscape.kernels.native.refinement import Refinement
from beltscape.kernels.native.rivals import Contest
from beltscape.kernels.native.top_view import Survey
from beltscape.kernels.native.triangulation import Triangulation
from beltscape.kernels.native.warping import Warping
from beltscape.kernels.native.windows import Windows

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


class NativeKernels(
    Triangulation,
    Warping,
    Occlusion,
    Coarse,
    Refinement,
    Propagation,
    Perceptron,
    Messages,
    Contest,
    Neighbourhood,
    Survey,
    Windows,
):
    """The kernels of one instruction-set level; every family is a base class, in its own file."""

    def __init__(self, level: str) -> None:
        self.name = level
        self._module = _module(level)
