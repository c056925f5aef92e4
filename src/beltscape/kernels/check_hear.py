"""What hear takes, checked once at the wrapper."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.check import float32
from beltscape.kernels.check_perceptron import network_layers


class Checked(NamedTuple):
    """Contiguous arrays of shapes that fit each other."""

    said: NDArray[np.float32]
    near: NDArray[np.int32]
    kept: NDArray[np.float32]
    layers: list[NDArray[np.float32]]


def hear_input(
    said: NDArray[np.floating],
    near: NDArray[np.int32],
    kept: NDArray[np.floating],
    layers: Sequence[NDArray[np.floating]],
) -> Checked:
    """The arrays as the kernels take them, or KernelError."""
    said = float32("said", said, ("K", "A"))
    if near.ndim != 2 or near.dtype != np.int32 or not near.size:
        raise KernelError(f"near must be (H, N) int32, not {near.dtype} {near.shape}")
    if near.min() < 0 or near.max() >= said.shape[1]:
        raise KernelError(f"near must be 0 to {said.shape[1] - 1}, not {near.min()} to {near.max()}")
    kept = float32("kept", kept, ("C", near.shape[1]))
    inputs = len(near) * len(said) + len(kept)
    return Checked(said, np.ascontiguousarray(near), kept, network_layers(layers, "inputs", inputs))
