"""What neighbours takes, checked once at the wrapper."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.check import float32
from beltscape.kernels.check_rivals import pixels


class Checked(NamedTuple):
    """Contiguous arrays of shapes that fit each other."""

    planes: list[NDArray[np.float32]]
    u: NDArray[np.float32]
    v: NDArray[np.float32]
    offsets: NDArray[np.int32]


def neighbours_input(
    planes: Sequence[NDArray[np.floating]],
    u: NDArray[np.integer],
    v: NDArray[np.integer],
    offsets: NDArray[np.integer],
) -> Checked:
    """The arrays as the kernels take them, or KernelError."""
    if not planes:
        raise KernelError("planes must be at least one")
    first = float32("planes[0]", planes[0], ("H", "W"))
    checked = [float32(f"planes[{i}]", plane, first.shape) for i, plane in enumerate(planes)]
    if offsets.ndim != 2 or offsets.shape[1] != 2 or offsets.dtype.kind not in "iu":
        raise KernelError(f"offsets must be (K, 2) integers, not {offsets.dtype} {offsets.shape}")
    return Checked(checked, *pixels(u, v, first.shape), np.ascontiguousarray(offsets, np.int32))
