"""What the perceptron takes, checked once at the wrapper."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.check import float32

_MOST = 256


class Checked(NamedTuple):
    """Contiguous float32, of shapes that fit each other."""

    planes: list[NDArray[np.float32]]
    limits: NDArray[np.float32]
    layers: list[NDArray[np.float32]]


def perceptron_input(
    planes: Sequence[NDArray[np.floating]],
    limits: NDArray[np.floating],
    layers: Sequence[NDArray[np.floating]],
) -> Checked:
    """The arrays as the kernels take them, or KernelError."""
    weights = network_layers(layers, "planes", len(planes))
    first = float32("planes[0]", planes[0], ("H", "W"))
    checked = [float32(f"planes[{i}]", plane, first.shape) for i, plane in enumerate(planes)]
    return Checked(checked, float32("limits", limits, (2, len(planes))), weights)


def network_layers(
    layers: Sequence[NDArray[np.floating]], what: str, inputs: int
) -> list[NDArray[np.float32]]:
    """A network's layers that fit each other and so many inputs, named for the error, or KernelError."""
    _demand_few(what, inputs)
    if not layers:
        raise KernelError("layers must be at least one")
    weights = []
    for i, layer in enumerate(layers):
        weights.append(float32(f"layers[{i}]", layer, ("k", inputs + 1)))
        inputs = len(weights[-1])
        _demand_few(f"units of layers[{i}]", inputs)
    return weights


def _demand_few(what: str, number: int) -> None:
    if not 1 <= number <= _MOST:
        raise KernelError(f"{what} must be 1 to {_MOST}, not {number}")
