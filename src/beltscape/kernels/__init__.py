"""The hot loops, behind one protocol; `load` is the only place that knows names."""

from __future__ import annotations

import os
from functools import cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError


class Kernels(Protocol):
    """What every set of kernels offers; stages receive one as a value."""

    name: str

    def triangulate(
        self, projections: NDArray[np.float64], pixels: NDArray[np.float64], *, threads: int = 0
    ) -> NDArray[np.float64]:
        """N points seen by any subset of n cameras, in the least-squares sense.

        Parameters
        ----------
        projections
            (n, 3, 4) projection matrices, frame in mm → undistorted pixels.
        pixels
            (n, N, 2) undistorted pixels; NaN where a camera does not see the point.
        threads
            How many threads; 0 takes all cores. The result does not depend on it.

        Returns
        -------
        (N, 3) points in mm; NaN where fewer than two cameras see a point or their rays are parallel.

        Raises
        ------
        KernelError
            When the shapes do not fit each other.

        References
        ----------
        Hou, Kang & Qiao, Sensors 2025, 25(7), 2111, doi:10.3390/s25072111, Eqs. 2-3.
        """
        ...


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
