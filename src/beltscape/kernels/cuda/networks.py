"""Plans of launches of networks and of message passing: native/cuda/networks.cuh."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.cuda.device import blocks_of
from beltscape.kernels.cuda.memory import DeviceArray
from beltscape.kernels.cuda.workspace import Workspace

MOST_LAYERS = 8
"""Of one network (``kMostLayers`` of networks.cuh)."""
_THREADS = 128, 1, 1
"""Of a block, which take a pixel each."""


def can_evaluate(given: Any) -> bool:
    """Return whether the network is within the limits of the kernels."""
    return len(given.layers) <= MOST_LAYERS


def evaluate_network(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.networks.NetworkKernels.evaluate_network`."""
    count, pixels = len(given.planes), given.planes[0].size
    planes = work.upload_all(given.planes)
    outputs = work.allocate((len(out), *out[0].shape), np.float32)
    features = planes, count, pixels, work.upload(given.limits)
    work.launch(
        "network_outputs", _grid(pixels), _THREADS, *features, *_upload_layers(work, given.layers), outputs
    )
    return [outputs.part(unit) for unit in range(len(out))]


def pass_messages(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.networks.MessagePassingKernels.pass_messages`."""
    length, senders = given.messages.shape
    quads = blocks_of(length, 4)
    rows = work.allocate((senders, 4 * quads), np.float32)
    messages = work.upload(given.messages), senders, length, quads
    work.launch("message_rows", _grid(senders), _THREADS, *messages, rows)
    received, pixels = given.senders.shape
    incoming = rows, length, quads, work.upload(given.senders), received
    state = work.upload(given.state), len(given.state), pixels
    outputs = work.allocate(out[0].shape, np.float32)
    layers = _upload_layers(work, given.layers)
    work.launch("message_outputs", _grid(pixels), _THREADS, *incoming, *state, *layers, outputs)
    return [outputs]


def _upload_layers(work: Workspace, layers: Sequence[NDArray[np.float32]]) -> tuple[Any, Any, int]:
    """Return the packed weights, the units of each layer, and the number of layers."""
    weights = np.concatenate([layer.ravel() for layer in layers])
    units = np.array([len(layer) for layer in layers], np.int32)
    return work.upload(weights), work.upload(units), len(layers)


def _grid(count: int) -> tuple[int, int, int]:
    return blocks_of(count, _THREADS[0]), 1, 1
