"""The arrays and launches of one call of a kernel, in one stream."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import prod
from threading import Lock
from typing import Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.cuda.constants import MOST_BYTES as CONSTANT_BYTES
from beltscape.kernels.cuda.device import GpuDevice, Size
from beltscape.kernels.cuda.memory import DeviceArray, MemoryBlock
from beltscape.kernels.resident import ResidentArray


@dataclass
class Traffic:
    """Copies between the memories of processor and device so far."""

    uploads: int = 0
    uploaded_bytes: int = 0
    downloads: int = 0
    downloaded_bytes: int = 0
    _lock: Lock = field(default_factory=Lock)

    def add_upload(self, size: int) -> None:
        """Count a copy to the device."""
        with self._lock:
            self.uploads, self.uploaded_bytes = self.uploads + 1, self.uploaded_bytes + size

    def add_download(self, size: int) -> None:
        """Count a copy to the processor."""
        with self._lock:
            self.downloads, self.downloaded_bytes = self.downloads + 1, self.downloaded_bytes + size

    @property
    def total_bytes(self) -> int:
        """Both ways."""
        return self.uploaded_bytes + self.downloaded_bytes


class Workspace:
    """A stream and the arrays of one call; `open_workspace` makes it.

    Every block that is used waits for its last uses in other streams, and afterwards has an event of this stream.
    """

    def __init__(self, device: GpuDevice, stream: Any, traffic: Traffic) -> None:
        self._device = device
        self._stream = stream
        self._traffic = traffic
        self._used: dict[int, MemoryBlock] = {}
        self._copies: dict[int, tuple[NDArray[Any], DeviceArray]] = {}
        """Arrays of the processor, by their ``id``, with the copies that this call already has."""

    def upload(self, array: NDArray[Any] | ResidentArray) -> DeviceArray:
        """Return an array of the device: a copy, or the resident array as it is."""
        if isinstance(array, ResidentArray):
            return self._use(array.on_device(self._upload_for_all))
        if id(array) in self._copies:
            return self._copies[id(array)][1]
        if array.nbytes <= CONSTANT_BYTES:
            return self._find_constant(np.ascontiguousarray(array))
        return self._copy(array)

    def _copy(self, array: NDArray[Any]) -> DeviceArray:
        values = np.ascontiguousarray(array)
        copy = self.allocate(values.shape, values.dtype)
        self._device.copy_in(self._stream, values, copy)
        self._traffic.add_upload(values.nbytes)
        self._copies[id(array)] = array, copy
        return copy

    def upload_all(self, arrays: Sequence[NDArray[Any] | ResidentArray]) -> DeviceArray:
        """Return the addresses (n,) of some arrays on the device."""
        places = [self.upload(array) for array in arrays]
        return self.upload(np.array([place.address for place in places], np.uint64))

    def upload_number(self, number: float | ResidentArray) -> DeviceArray:
        """Return the address of a number in single precision, for kernels that read it from memory."""
        if isinstance(number, ResidentArray):
            return self.upload(number)
        return self.upload(np.array([number], np.float32))

    def allocate(self, shape: tuple[int, ...], dtype: DTypeLike) -> DeviceArray:
        """Return an array of arbitrary values."""
        kind = np.dtype(dtype)
        sizes = tuple(int(n) for n in shape)  # sums of NumPy's integers would overflow
        block = self._device.memory.take(prod(sizes) * kind.itemsize)
        return self._use(DeviceArray(block, sizes, kind))

    def launch(self, kernel: str, grid: Size, block: Size, *arguments: Any, shared_bytes: int = 0) -> None:
        """Run a kernel; see `beltscape.kernels.cuda.device.GpuDevice`."""
        self._device.launch(self._stream, kernel, grid, block, arguments, shared_bytes)

    def use(self, blocks: Iterable[MemoryBlock]) -> None:
        """Wait for the last uses of memory that the next graph reads or writes, and note this one."""
        for each in blocks:
            self._use_block(each)

    def copy_to(self, source: NDArray[Any] | DeviceArray, array: DeviceArray) -> None:
        """Copy an array of the processor or of the device to one of the device."""
        if isinstance(source, DeviceArray):
            self._device.copy_within(self._stream, self._use(source), array)
            return
        self._device.copy_in(self._stream, np.ascontiguousarray(source), array)
        self._traffic.add_upload(source.nbytes)

    def launch_graph(self, graph: Any) -> None:
        """Run a graph of `beltscape.kernels.cuda.device.GpuDevice`, whose memory is in use already."""
        self._device.launch_graph(self._stream, graph)

    def download(self, array: DeviceArray, out: NDArray[Any]) -> None:
        """Copy an array to ``out``, once all launches before have ended."""
        into = out if out.flags.c_contiguous else np.empty(out.shape, out.dtype)
        if into.nbytes != array.nbytes:
            raise KernelError(f"a result of {array.nbytes} bytes does not fit an array of {into.nbytes}")
        self._device.copy_out(self._stream, self._use(array), into)
        self._traffic.add_download(into.nbytes)
        if into is not out:
            out[...] = into

    def download_new(self, array: DeviceArray) -> NDArray[Any]:
        """Return a copy of an array."""
        out = np.empty(array.shape, array.dtype)
        self.download(array, out)
        return out

    def read_constant(self, array: DeviceArray) -> NDArray[Any]:
        """Return a copy of an array that does not depend on a frame's images, so that a graph may be made by it."""
        return self.download_new(array)

    def close(self) -> None:
        """Let the blocks' next users wait for this stream."""
        event = self._device.record(self._stream)
        for block in self._used.values():
            block.events[id(self._stream)] = event
        self._device.constants.note_use(id(self._stream), event)
        self._used.clear()
        self._copies.clear()

    def _find_constant(self, array: NDArray[Any]) -> DeviceArray:
        """Return a small array that may be on the device already; it is waited for, but never noted as used."""
        key = array.dtype.str, array.shape, array.tobytes()
        found = self._device.constants.find(key, lambda: self._upload_for_all(array))
        own = id(self._stream)
        for stream, event in list(found.block.events.items()):
            if stream != own:
                self._device.wait(self._stream, event)
        self._used.pop(id(found.block), None)
        return found

    def _upload_for_all(self, array: NDArray[Any]) -> DeviceArray:
        """Upload what other streams may use before this call ends: they wait for the copy."""
        copy = self._copy(array)
        copy.block.events[id(self._stream)] = self._device.record(self._stream)
        return copy

    def _use(self, array: DeviceArray) -> DeviceArray:
        self._use_block(array.block)
        return array

    def _use_block(self, block: MemoryBlock) -> None:
        if id(block) not in self._used:
            for stream, event in list(block.events.items()):
                if stream != id(self._stream):
                    self._device.wait(self._stream, event)
            self._used[id(block)] = block


Kind = TypeVar("Kind", bound=Workspace)


@contextmanager
def open_workspace(
    device: GpuDevice, traffic: Traffic, make: Callable[[GpuDevice, Any, Traffic], Kind] = Workspace
) -> Generator[Kind]:
    """Return the workspace of one call on a device; its copies are added to ``traffic``."""
    stream = device.open_stream()
    try:
        work = make(device, stream, traffic)
        yield work
        work.close()
    finally:
        device.close_stream(stream)
