"""Plans of launches of networks and of message passing: native/cuda/networks.cuh."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.arrays import MOST_LAYERS
from beltscape.kernels.cuda.device import blocks_of
from beltscape.kernels.cuda.memory import DeviceArray
from beltscape.kernels.cuda.planes import upload_programs
from beltscape.kernels.cuda.workspace import Workspace

SENDERS = 2
"""Senders without a state of their own (``kSenders`` of networks.cuh)."""
_THREADS = 128, 1, 1
"""Of a block, which take a pixel each."""


def can_exchange(given: Any) -> bool:
    """Return whether all rounds are within the limits of the kernels."""
    return all(len(layers) <= MOST_LAYERS for layers in given.rounds)


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


def evaluate_network_of_programs(
    work: Workspace, given: Any, out: Sequence[NDArray[Any]]
) -> list[DeviceArray]:
    """Compute `beltscape.kernels.networks.NetworkKernels.evaluate_network` of features that are expressions."""
    height, width = out[0].shape
    program, inputs = upload_programs(work, given)
    results = work.allocate((len(out), height, width), np.float32)
    features = program, work.upload(given.ends), work.upload(given.stored_rows), len(given.ends)
    layers = work.upload(given.limits), *_upload_layers(work, given.layers)
    grid = _grid(height * width)
    work.launch("network_of_programs", grid, _THREADS, *features, *inputs, width, height, *layers, results)
    return [results.part(i) for i in range(len(out))]


def pass_messages(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.networks.MessagePassingKernels.pass_messages`."""
    del out
    messages, senders, state = map(work.upload, (given.messages, given.senders, given.state))
    return [_pass_messages(work, messages, senders, state, given.layers)]


def exchange_messages(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.networks.MessagePassingKernels.exchange_messages`."""
    del out
    length, pixels = given.length, given.senders.shape[1]
    senders, own = work.upload(given.senders), len(given.states) - given.length
    messages = work.allocate((length + SENDERS, SENDERS + pixels), np.float32)
    rest = work.allocate((own, pixels), np.float32)
    grid = blocks_of(SENDERS + pixels, _THREADS[0]), length + SENDERS + own, 1
    states = work.upload_all(given.states), length, pixels
    work.launch("place_states", grid, _THREADS, *states, messages, rest)
    *changes, last = given.rounds
    for layers in changes:
        change = _pass_messages(work, messages, senders, rest, layers)
        grid = blocks_of(pixels, _THREADS[0]), length + own, 1
        work.launch("add_changes", grid, _THREADS, change, length, pixels, messages, rest)
    return [_pass_messages(work, messages, senders, rest, last)]


def _pass_messages(
    work: Workspace,
    messages: DeviceArray,
    senders: DeviceArray,
    state: DeviceArray,
    layers: Sequence[NDArray[np.float32]],
) -> DeviceArray:
    """Return the outputs (units of the last layer, N) of one round."""
    length, count = messages.shape
    quads = blocks_of(length, 4)
    rows = work.allocate((count, 4 * quads), np.float32)
    work.launch("message_rows", _grid(count), _THREADS, messages, count, length, quads, rows)
    received, pixels = senders.shape
    incoming = rows, length, quads, senders, received
    own = state, state.shape[0], pixels
    outputs = work.allocate((len(layers[-1]), pixels), np.float32)
    weights = _upload_layers(work, layers)
    work.launch("message_outputs", _grid(pixels), _THREADS, *incoming, *own, *weights, outputs)
    return outputs


def _upload_layers(work: Workspace, layers: Sequence[NDArray[np.float32]]) -> tuple[Any, Any, int]:
    """Return the packed weights, the units of each layer, and the number of layers."""
    weights = np.concatenate([layer.ravel() for layer in layers])
    units = np.array([len(layer) for layer in layers], np.int32)
    return work.upload(weights), work.upload(units), len(layers)


def _grid(count: int) -> tuple[int, int, int]:
    return blocks_of(count, _THREADS[0]), 1, 1
