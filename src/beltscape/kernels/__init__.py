"""The hot loops, behind one protocol; `load` is the only place that knows names."""

from __future__ import annotations

import os
from functools import cache

from beltscape.core.errors import KernelError
from beltscape.kernels.protocol import Kernels

__all__ = ["Kernels", "load"]


@cache
def load(name: str | None = None) -> Kernels:
    """Kernels by name: ``native`` (the best level of this processor), ``v2``, ``v3``, ``v4``, ``reference``.

    Without a name the environment variable BELTSCAPE_KERNELS is asked, then ``native`` is taken.
    """
    name = name or os.environ.get("BELTSCAPE_KERNELS") or "native"
    if name == "reference":
        from beltscape.kernels.reference import ReferenceKernels

        return ReferenceKernels()
    from beltscape.kernels.native import NativeKernels, levels

    if name == "native":
        return NativeKernels(levels()[-1])
    if name in levels():
        return NativeKernels(name)
    raise KernelError(
        f"no kernels named {name!r} on this processor; there are reference, native, {', '.join(levels())}"
    )
