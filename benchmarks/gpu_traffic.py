"""What a frame copies between processor and GPU, counted without a GPU: the native kernels, with arrays as on one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels
from beltscape.kernels.backend import Backend
from beltscape.kernels.cuda.arguments import Given, describe
from beltscape.kernels.cuda.backend import ResidentBackend, find_plan
from beltscape.kernels.cuda.workspace import Traffic
from beltscape.kernels.networks import evaluate_by_planes, exchange_by_rounds
from beltscape.kernels.resident import ResidentArray, as_host
from matching.operations import OPERATIONS
from roofline import Work, count_bytes


@dataclass(frozen=True)
class _Held:
    """An array as the device would hold it."""

    array: NDArray[Any]

    @property
    def shape(self) -> tuple[int, ...]:
        return self.array.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.array.dtype

    def part(self, i: int) -> _Held:
        return _Held(self.array[i])

    def rows(self, first: int, last: int) -> _Held:
        return _Held(self.array[first:last])

    def viewed(self, dtype: np.dtype[Any]) -> _Held:
        return _Held(self.array.view(dtype))

    def reshaped(self, shape: tuple[int, ...]) -> _Held:
        return _Held(self.array.reshape(shape))


class CountingBackend:
    """Computes on the processor, keeps arrays as `ResidentBackend` does, and counts what that would copy."""

    failure: str | None = None
    pixels_at_once = ResidentBackend.pixels_at_once

    def __init__(self, native: Backend) -> None:
        self.name = "counting"
        self.traffic = Traffic()
        self.each_call_bytes = 0
        """What copying every array at every call would move, as a back end without resident arrays does."""
        self.resident = self
        self.work: dict[str, Work] = {}
        """Kernel → its calls, the bytes of its arrays in and out, and its operations."""
        self._copies: dict[int, _Held] = {}
        self._native = native

    def run(
        self, kernel: str, given: Any, out: Sequence[NDArray[Any]], threads: int
    ) -> Sequence[NDArray[Any]]:
        """See `beltscape.kernels.backend.Backend`."""
        if find_plan(kernel, given) is None:
            return self._native.run(kernel, as_host(given), out, threads)
        self._copies.clear()
        record = self._read(given)
        if kernel == "exchange_messages":
            results = [exchange_by_rounds(Kernels(self._native), record, threads)]
        elif kernel == "evaluate_network_of_programs":
            results = list(evaluate_by_planes(Kernels(self._native), record, out[0].shape, threads))
        else:
            results = self._native.run(kernel, record, out, threads)
        self.each_call_bytes += sum(array.nbytes for array in results)
        work = self.work.setdefault(kernel, Work())
        work.calls += 1
        work.bytes += count_bytes(record, len(record.u) if hasattr(record, "u") else None)
        work.bytes += count_bytes(list(results))
        work.operations += OPERATIONS[kernel](record, results)
        held = (_Held(np.asarray(array, order="C")) for array in results)
        return [cast("NDArray[Any]", ResidentArray.from_device(each, self)) for each in held]

    def keep(self, array: NDArray[Any]) -> NDArray[Any]:
        """See `beltscape.kernels.cuda.backend.ResidentBackend.keep`."""
        if isinstance(array, ResidentArray):
            array.mark_reused()
            return array
        return cast("NDArray[Any]", ResidentArray.from_host(array, self))

    def replay(self, function: Callable[..., Any], given: Sequence[Any]) -> Any:
        """Return ``function(*given)``; as those of a graph, results that are expressions are computed."""
        result, arrays = function(*given), Given()
        describe(result, arrays)
        for each in (*arrays.arrays, *arrays.numbers):
            if isinstance(each, ResidentArray):
                each.on_device(self.upload)
        return result

    def _read(self, value: Any) -> Any:
        """Return a record with arrays for the native kernels, and count those that are copied to the device."""
        if isinstance(value, ResidentArray):
            array = value.on_device(self.upload).array
            self.each_call_bytes += array.nbytes
            return array
        if isinstance(value, np.ndarray):
            self.each_call_bytes += value.nbytes
            if id(value) not in self._copies:
                self._copies[id(value)] = self.upload(value)
            return self._copies[id(value)].array
        if isinstance(value, list):
            return [self._read(each) for each in value]
        if isinstance(value, tuple):
            parts = map(self._read, value)
            return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
        return value

    def upload(self, array: NDArray[Any]) -> _Held:
        """See `beltscape.kernels.resident.ResidentOperations`."""
        self.traffic.add_upload(array.nbytes)
        return _Held(array)

    def download(self, array: _Held) -> NDArray[Any]:
        """See `beltscape.kernels.resident.ResidentOperations`."""
        self.traffic.add_download(array.array.nbytes)
        return array.array.copy()
