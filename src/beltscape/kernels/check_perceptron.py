"""What the perceptron takes, checked once at the wrapper."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.check import float32

_MOST_PLANES, _MOST_ANSWERS = 64, 8


class Checked(NamedTuple):
    """Contiguous float32, of shapes that fit each other."""

    planes: list[NDArray[np.float32]]
    limits: NDArray[np.float32]
    hidden: NDArray[np.float32]
    output: NDArray[np.float32]


def perceptron_input(
    planes: Sequence[NDArray[np.floating]],
    limits: NDArray[np.floating],
    hidden: NDArray[np.floating],
    output: NDArray[np.floating],
) -> Checked:
    """The arrays as the kernels take them, or KernelError."""
    if not 1 <= len(planes) <= _MOST_PLANES:
        raise KernelError(f"planes must be 1 to {_MOST_PLANES}, not {len(planes)}")
    first = float32("planes[0]", planes[0], ("H", "W"))
    checked = [float32(f"planes[{i}]", plane, first.shape) for i, plane in enumerate(planes)]
    hidden = float32("hidden", hidden, ("k", len(planes) + 1))
    output = float32("output", output, ("m", len(hidden) + 1))
    if len(output) > _MOST_ANSWERS:
        raise KernelError(f"output must have at most {_MOST_ANSWERS} rows, not {len(output)}")
    return Checked(checked, float32("limits", limits, (2, len(planes))), hidden, output)
