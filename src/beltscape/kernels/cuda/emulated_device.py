"""The emulated GPU: the kernels' own source, compiled for the CPU (native/emulation), with memory of its own."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.cuda.constants import ConstantCache
from beltscape.kernels.cuda.device import Launch, Size
from beltscape.kernels.cuda.memory import MOST_BYTES, DeviceArray, DeviceError, MemoryPool

_MODULE = "beltscape.kernels._emulated"
_GUARD_BYTES, _GUARD, _POISON = 64, 0xA5, 0xFF
"""Around every array, and in it where nothing was written yet: NaN as a float, -1 as an integer."""


def is_emulation_built() -> bool:
    """Return whether this installation has the emulated GPU; `make dev` builds it, wheels lack it."""
    return find_spec(_MODULE) is not None


class EmulatedMemory:
    """Memory between guards."""

    def __init__(self, size: int) -> None:
        self._all = np.full(size + 2 * _GUARD_BYTES, _GUARD, np.uint8)
        self.values = self._all[_GUARD_BYTES : _GUARD_BYTES + size]

    @property
    def address(self) -> int:
        """Of its first byte."""
        return int(self.values.ctypes.data)

    @property
    def is_intact(self) -> bool:
        """Whether nothing was written past its ends."""
        return bool(
            (self._all[:_GUARD_BYTES] == _GUARD).all() and (self._all[-_GUARD_BYTES:] == _GUARD).all()
        )

    def poison(self) -> None:
        """Fill it with NaN."""
        self.values[:] = _POISON


class EmulatedDevice:
    """Runs kernels on the CPU; ``seed`` permutes blocks and threads (0: in the order of their numbers).

    Arrays of the processor are none of the device's: a kernel that is given one, and NumPy that is given one of the
    device, fail. A kernel that writes past an array's ends is an error. Nothing runs later than it is called.
    """

    def __init__(self, seed: int = 0, most_bytes: int = MOST_BYTES) -> None:
        if not is_emulation_built():
            raise KernelError("the emulated GPU is not built; run: make dev")
        self.name = "emulated"
        self.memory = MemoryPool(
            EmulatedMemory, lambda *_: None, most_bytes, grain=1, prepare=EmulatedMemory.poison
        )
        self.constants = ConstantCache()
        self._module = import_module(_MODULE)
        self._seed = seed
        self._launches = 0
        self._open = set[object]()

    def open_stream(self) -> Any:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        stream = object()
        self._open.add(stream)
        return stream

    def close_stream(self, stream: Any) -> None:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        self._open.remove(stream)

    def copy_in(self, stream: Any, host: NDArray[Any], array: DeviceArray) -> None:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        self._require_open(stream)
        view_memory(array)[...] = host

    def copy_out(self, stream: Any, array: DeviceArray, host: NDArray[Any]) -> None:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        self._require_open(stream)
        host[...] = view_memory(array).reshape(host.shape)

    def launch(
        self, stream: Any, kernel: str, grid: Size, block: Size, arguments: Sequence[Any], shared_bytes: int
    ) -> None:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        self._require_open(stream)
        self._launches += 1
        seed = self._seed and self._seed * 1000 + self._launches
        arrays = [each for each in arguments if isinstance(each, DeviceArray)]
        if any(isinstance(each, np.ndarray) for each in arguments):
            raise TypeError(f"{kernel}: an array of the processor is given to the device")
        given = [view_memory(each) if isinstance(each, DeviceArray) else each for each in arguments]
        try:
            getattr(self._module, kernel)(grid, block, shared_bytes, seed, given)
        except RuntimeError as error:
            raise DeviceError(f"{kernel}: {error}") from error
        if not all(each.block.raw.is_intact for each in arrays):
            raise DeviceError(f"{kernel}: a kernel writes past the ends of an array")

    def copy_within(self, stream: Any, source: DeviceArray, array: DeviceArray) -> None:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        self._require_open(stream)
        view_memory(array)[...] = view_memory(source).reshape(array.shape)

    def make_graph(self, launches: Sequence[Launch]) -> Any:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        return tuple(launches)

    def launch_graph(self, stream: Any, graph: Any) -> None:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        for each in graph:
            self.launch(stream, *each)

    def finish(self, events: Sequence[Any]) -> None:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""

    def record(self, stream: Any) -> Any:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        self._require_open(stream)

    def wait(self, stream: Any, event: Any) -> None:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        del event
        self._require_open(stream)

    def _require_open(self, stream: object) -> None:
        if stream not in self._open:
            raise ValueError("the stream was closed before")


def view_memory(array: DeviceArray) -> NDArray[Any]:
    """Return what lies in the emulated memory of an array."""
    values = array.block.raw.values[array.offset : array.offset + array.nbytes]
    return values.view(array.dtype).reshape(array.shape)
