"""Kernels of networks: rectified layers evaluated at every pixel, and rounds of messages between pixels."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.arrays import MOST_LAYERS, float32
from beltscape.kernels.backend import KernelFamily
from beltscape.kernels.expressions import (
    FLOAT,
    ExpressionInput,
    ProgramWriter,
    evaluate_program,
    flatten_shape,
)
from beltscape.kernels.resident import ResidentArray

_MOST_UNITS = 256
"""Largest number of inputs, and of units of a layer; the native kernel's arrays have this size."""


class NetworkInput(NamedTuple):
    """Checked input of `evaluate_network`."""

    planes: list[NDArray[np.float32]]
    """n of (H, W)"""
    limits: NDArray[np.float32]
    """(2, n)"""
    layers: list[NDArray[np.float32]]


class ProgramNetworkInput(NamedTuple):
    """Checked input of `evaluate_network_of_programs`, a network of n features that are expressions of a GPU."""

    program: NDArray[np.int32]
    """(length, 2) of all features, one after the other; see `beltscape.kernels.expressions.ExpressionInput`."""
    ends: NDArray[np.int32]
    """(n,) where each feature's program ends."""
    constants: NDArray[np.float32]
    """(k,) of all programs, as the inputs."""
    inputs: list[Any]
    stored_rows: NDArray[np.int32]
    """(n,) row of each feature among the results after the network's outputs; -1 for one that is not stored."""
    limits: NDArray[np.float32]
    """(2, n)"""
    layers: list[NDArray[np.float32]]


class NetworkKernels(KernelFamily):
    """Kernel of a multilayer perceptron at every pixel."""

    def evaluate_network(
        self,
        planes: Sequence[NDArray[np.floating]],
        limits: NDArray[np.floating],
        layers: Sequence[NDArray[np.floating]],
        *,
        threads: int = 0,
        out: Sequence[NDArray[np.float32]] | None = None,
    ) -> Sequence[NDArray[np.floating]]:
        """Return a network's outputs for each pixel's features x.

            x₀ = min(max(x, low), high),  xᵢ₊₁ = max(0, Wᵢ xᵢ + wᵢ),  out = the last layer's W x + w

        Parameters
        ----------
        planes
            n of (H, W), at most 256: the features. NaN counts as ``low``.
        limits
            (2, n): low, then high.
        layers
            (k, n + 1), each of at most 256 units k: W and in its last column w; n is the k of the layer before.
        out
            Where the outputs are written, contiguous (H, W) float32, one per unit of the last layer; new by default.

        Returns
        -------
        (H, W) float32, one per unit of the last layer.

        References
        ----------
        Rumelhart, Hinton & Williams, Nature 323, 533–536, 1986, doi:10.1038/323533a0.
        """
        weights = network_layers(layers, "planes", len(planes))
        first = float32("planes[0]", planes[0], ("H", "W"))
        checked = [float32(f"planes[{i}]", plane, first.shape) for i, plane in enumerate(planes)]
        given = NetworkInput(checked, float32("limits", limits, (2, len(planes))), weights)
        if out is None:
            new = [np.empty(first.shape, np.float32) for _ in weights[-1]]
            fused = _write_programs(given)
            if fused:
                return self._run_programs(fused, checked, new)
            found = self._run("evaluate_network", given, new, threads)
            return [output.astype(np.float32, copy=False) for output in found]
        _check_outputs(out, len(weights[-1]), first.shape)
        for array, output in zip(out, self._run("evaluate_network", given, out, threads), strict=True):
            if output is not array:  # the reference returns arrays of its own
                array[:] = output
        return out

    def _run_programs(
        self, given: ProgramNetworkInput, planes: Sequence[Any], out: Sequence[NDArray[np.float32]]
    ) -> Sequence[NDArray[np.floating]]:
        """Return the outputs of a network of expressions; those that others take, too, are written besides."""
        reused = [plane for plane, row in zip(planes, given.stored_rows, strict=True) if row >= 0]
        new = [*out, *(np.empty_like(out[0]) for _ in reused)]
        outputs = self._run("evaluate_network_of_programs", given, new, 1)
        for plane, found in zip(reused, outputs[len(out) :], strict=True):
            plane.adopt_result(found)
        return outputs[: len(out)]


def network_layers(
    layers: Sequence[NDArray[np.floating]], what: str, inputs: int
) -> list[NDArray[np.float32]]:
    """Return layers that fit each other and the inputs (``what`` in errors), or raise KernelError."""
    _check_number(what, inputs)
    if not layers:
        raise KernelError("layers must be at least one")
    weights: list[NDArray[np.float32]] = []
    for i, layer in enumerate(layers):
        weights.append(float32(f"layers[{i}]", layer, ("k", inputs + 1)))
        inputs = len(weights[-1])
        _check_number(f"units of layers[{i}]", inputs)
    return weights


def _check_number(what: str, number: int) -> None:
    if not 1 <= number <= _MOST_UNITS:
        raise KernelError(f"{what} must be 1 to {_MOST_UNITS}, not {number}")


def _check_outputs(out: Sequence[NDArray[np.float32]], number: int, shape: tuple[int, ...]) -> None:
    if len(out) != number:
        raise KernelError(f"out must be {number} arrays, not {len(out)}")
    for i, array in enumerate(out):
        if array.shape != shape or array.dtype != np.float32 or not array.flags.c_contiguous:
            raise KernelError(f"out[{i}] must be contiguous float32 {shape}, not {array.dtype} {array.shape}")


def _write_programs(given: NetworkInput) -> ProgramNetworkInput | None:
    """Return a network with its features as programs; None where none is an expression of a GPU any more."""
    planes: list[Any] = list(given.planes)
    is_resident = all(isinstance(each, ResidentArray) and each.operations for each in planes)
    if not is_resident or len(given.layers) > MOST_LAYERS:
        return None
    writer, ends, stored_rows, rows = ProgramWriter(), list[int](), list[int](), count()
    for each in planes:
        stored_rows.append(next(rows) if each.is_awaited else -1)
        writer.add(each.operand)
        ends.append(len(writer.code))
    if len(writer.code) == len(planes):
        return None
    inputs = [ResidentArray(each).reshape(flatten_shape(each.shape)) for each in writer.inputs]
    program, constants, _ = writer.finish(inputs)
    of_features = np.array(ends, np.int32), constants, inputs, np.array(stored_rows, np.int32)
    return ProgramNetworkInput(program, *of_features, given.limits, given.layers)


def evaluate_by_planes(
    kernels: NetworkKernels, given: ProgramNetworkInput, shape: tuple[int, ...], threads: int
) -> Sequence[NDArray[np.floating]]:
    """Return what a network of expressions gives, each of which is computed first; on the processor."""
    starts = [0, *given.ends[:-1].tolist()]
    planes = [
        evaluate_program(
            ExpressionInput(given.program[start:end], given.constants, given.inputs), shape, FLOAT
        )
        for start, end in zip(starts, given.ends.tolist(), strict=True)
    ]
    written = [plane for plane, row in zip(planes, given.stored_rows, strict=True) if row >= 0]
    return [*kernels.evaluate_network(planes, given.limits, given.layers, threads=threads), *written]


class MessagePassingInput(NamedTuple):
    """Checked input of `pass_messages`."""

    messages: NDArray[np.float32]
    """(K, A)"""
    senders: NDArray[np.int32]
    """(H, N)"""
    state: NDArray[np.float32]
    """(C, N)"""
    layers: list[NDArray[np.float32]]


class MessagePassingKernels(KernelFamily):
    """Kernel of a round of messages between pixels."""

    def pass_messages(
        self,
        messages: NDArray[np.floating],
        senders: NDArray[np.int32],
        state: NDArray[np.floating],
        layers: Sequence[NDArray[np.floating]],
        *,
        threads: int = 0,
    ) -> NDArray[np.floating]:
        """Return a network's outputs for the messages that each pixel receives and its own state.

            x₀ = (messages[0, senders[0]], messages[0, senders[1]], …, messages[K − 1, senders[H − 1]], state),
            xᵢ₊₁ = max(0, Wᵢ xᵢ + wᵢ),  out = the last layer's W x + w

        Parameters
        ----------
        messages
            (K, A): a message of K numbers from each of A senders.
        senders
            (H, N): the H senders of each of N pixels.
        state
            (C, N): the rest of each pixel's own state.
        layers
            (k, n + 1), each of at most 256 units k: W and in its last column w; the first n is H K + C, at most 256.

        Returns
        -------
        (M, N) float32, a row per unit of the last layer.

        References
        ----------
        Gilmer, Schoenholz, Riley, Vinyals & Dahl, ICML 2017, arXiv:1704.01212; here messages are not summed.
        """
        messages = float32("messages", messages, ("K", "A"))
        if senders.ndim != 2 or senders.dtype != np.int32 or not senders.size:
            raise KernelError(f"senders must be (H, N) int32, not {senders.dtype} {senders.shape}")
        if senders.view(np.uint32).max() >= messages.shape[1]:  # negative numbers are large ones
            raise KernelError(
                f"senders must be 0 to {messages.shape[1] - 1}, not {senders.min()} to {senders.max()}"
            )
        state = float32("state", state, ("C", senders.shape[1]))
        weights = network_layers(layers, "inputs", len(senders) * len(messages) + len(state))
        given = MessagePassingInput(messages, np.ascontiguousarray(senders), state, weights)
        out = np.empty((len(weights[-1]), senders.shape[1]), np.float32)
        (outputs,) = self._run("pass_messages", given, (out,), threads)
        return outputs

    def exchange_messages(
        self,
        states: Sequence[NDArray[np.floating]],
        senders: NDArray[np.int32],
        rounds: Sequence[Sequence[NDArray[np.floating]]],
        *,
        threads: int = 0,
    ) -> NDArray[np.floating]:
        """Return the last round's outputs, after all rounds before have changed the states.

        A pixel's message is the first numbers of its state and two flags, both 0. The first two senders have no
        state; their messages are 0 but for the first and the second flag. Every round but the last gives the change
        of each pixel's state, message first. How long messages are follows from the first layer's inputs.

        Parameters
        ----------
        states
            S of (N,): the numbers of each pixel's state.
        senders
            (H, N): the senders of each pixel, at least two; pixel i is sender 2 + i.
        rounds
            The layers of each round, as in `pass_messages`.

        Returns
        -------
        (M, N) float32, a row per unit of the last round's last layer.
        """
        pixels = senders.shape[1]
        checked = [float32(f"states[{i}]", state, (pixels,)) for i, state in enumerate(states)]
        if len(senders) < 2 or not rounds:
            raise KernelError(f"rounds need two senders or more, not {len(senders)} in {len(rounds)} rounds")
        own = rounds[0][0].shape[1] - 1 - len(senders) * len(FLAGS) - len(states)
        length = own // (len(senders) - 1)
        inputs = len(senders) * (length + len(FLAGS)) + len(states) - length
        weights = [network_layers(layers, "inputs", inputs) for layers in rounds]
        if not isinstance(senders, ResidentArray):
            senders = np.ascontiguousarray(senders, np.int32)
        given = MessageRoundsInput(checked, senders, weights, length)
        if not hasattr(self.backend, "keep"):
            return exchange_by_rounds(self, given, threads)
        out = np.empty((len(weights[-1][-1]), pixels), np.float32)
        (outputs,) = self._run("exchange_messages", given, (out,), threads)
        return outputs


FLAGS = np.array([[1, 0], [0, 1]], np.float32)
"""(2, 2) last two numbers of the messages of the two senders without a state."""


class MessageRoundsInput(NamedTuple):
    """Checked input of `exchange_messages`."""

    states: list[NDArray[np.float32]]
    """S of (N,)"""
    senders: NDArray[np.int32]
    """(H, N)"""
    rounds: list[list[NDArray[np.float32]]]
    length: int


def exchange_by_rounds(
    kernels: MessagePassingKernels, given: MessageRoundsInput, threads: int
) -> NDArray[np.floating]:
    """Return what `MessagePassingKernels.exchange_messages` does, by a call of `pass_messages` for each round."""
    length, first = given.length, len(FLAGS)
    rest = np.array(given.states[length:], np.float32).reshape(-1, given.senders.shape[1])
    messages = np.zeros((length + first, first + rest.shape[1]), np.float32)
    messages[:length, first:], messages[length:, :first] = given.states[:length], FLAGS
    *changes, last = given.rounds
    for layers in changes:
        change = kernels.pass_messages(messages, given.senders, rest, layers, threads=threads)
        messages[:length, first:] += change[:length]
        rest += change[length:]
    return kernels.pass_messages(messages, given.senders, rest, last, threads=threads)
