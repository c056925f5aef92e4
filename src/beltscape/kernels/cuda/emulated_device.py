"""The emulated GPU: the kernels' own source, compiled for the CPU (native/emulation), in host memory."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.cuda.device import DeviceError, Size

_MODULE = "beltscape.kernels._emulated"
_GUARD_BYTES, _GUARD, _POISON = 64, 0xA5, 0xFF
"""Around every array, and in it where nothing was written yet: NaN as a float, -1 as an integer."""


def is_emulation_built() -> bool:
    """Return whether this installation has the emulated GPU; `make dev` builds it, wheels lack it."""
    return find_spec(_MODULE) is not None


class EmulatedDevice:
    """Runs kernels on the CPU; ``seed`` permutes blocks and threads (0: in the order of their numbers)."""

    def __init__(self, seed: int = 0) -> None:
        if not is_emulation_built():
            raise KernelError("the emulated GPU is not built; run: make dev")
        self.name = "emulated"
        self._module = import_module(_MODULE)
        self._seed = seed

    @contextmanager
    def workspace(self) -> Generator[EmulatedWorkspace]:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        yield EmulatedWorkspace(self._module, self._seed)


class EmulatedWorkspace:
    """Host arrays between guards; a kernel that writes past an array's ends is an error."""

    def __init__(self, module: ModuleType, seed: int) -> None:
        self._module = module
        self._seed = seed
        self._launches = 0
        self._buffers: list[NDArray[np.uint8]] = []

    def upload(self, array: NDArray[Any]) -> NDArray[Any]:
        """See `beltscape.kernels.cuda.device.Workspace`."""
        copy = self.allocate(array.shape, array.dtype)
        copy[...] = array
        return copy

    def allocate(self, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """See `beltscape.kernels.cuda.device.Workspace`."""
        size = int(np.prod(shape)) * np.dtype(dtype).itemsize
        buffer = np.full(size + 2 * _GUARD_BYTES, _GUARD, np.uint8)
        self._buffers.append(buffer)
        inner = buffer[_GUARD_BYTES : _GUARD_BYTES + size]
        inner[:] = _POISON
        return inner.view(dtype).reshape(shape)

    def part(self, array: NDArray[Any], i: int) -> NDArray[Any]:
        """See `beltscape.kernels.cuda.device.Workspace`."""
        return array[i]

    def launch(self, kernel: str, grid: Size, block: Size, *arguments: Any, shared_bytes: int = 0) -> None:
        """See `beltscape.kernels.cuda.device.Workspace`."""
        self._launches += 1
        seed = self._seed and self._seed * 1000 + self._launches
        try:
            getattr(self._module, kernel)(grid, block, shared_bytes, seed, arguments)
        except RuntimeError as error:
            raise DeviceError(f"{kernel}: {error}") from error
        for buffer in self._buffers:
            if (buffer[:_GUARD_BYTES] != _GUARD).any() or (buffer[-_GUARD_BYTES:] != _GUARD).any():
                raise DeviceError(f"{kernel}: a kernel writes past the ends of an array")

    def download(self, array: NDArray[Any], out: NDArray[Any]) -> None:
        """See `beltscape.kernels.cuda.device.Workspace`."""
        out[...] = array
