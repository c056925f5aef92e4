"""What a plan of launches needs of a device: memory, launches of kernels by name, copies there and back."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any, Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

SHARED_BYTES = 48 << 10
"""Shared memory of a block that every GPU gives; more needs a driver's leave."""

Size = tuple[int, int, int]
"""Along x, y and z."""


class DeviceError(Exception):
    """The device failed: it is lost, has no memory left, or a kernel went wrong."""


class DeviceArray(Protocol):
    """An array in the device's memory."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Elements along each axis."""
        ...


class Workspace(Protocol):
    """The arrays and launches of one call, in one order; they end with it."""

    def upload(self, array: NDArray[Any]) -> Any:
        """Return a copy in the device's memory."""
        ...

    def allocate(self, shape: tuple[int, ...], dtype: DTypeLike) -> Any:
        """Return an array of arbitrary values."""
        ...

    def part(self, array: Any, i: int) -> Any:
        """Return the i-th part of an array along its first axis, in the same memory."""
        ...

    def launch(self, kernel: str, grid: Size, block: Size, *arguments: Any, shared_bytes: int = 0) -> None:
        """Run a kernel of native/cuda by its name.

        Arguments are arrays of the device, int and float, just as the kernel declares them: nothing is converted.
        """
        ...

    def download(self, array: Any, out: NDArray[Any]) -> None:
        """Copy an array to ``out``, once all launches before have ended."""
        ...


class GpuDevice(Protocol):
    """A GPU, or an emulated one."""

    name: str

    def workspace(self) -> AbstractContextManager[Workspace]:
        """Return the workspace of one call."""
        ...


def blocks_of(count: int, of: int) -> int:
    """Return how many blocks of ``of`` cover ``count``."""
    return -(-count // of)


def download(work: Workspace, array: Any, dtype: DTypeLike) -> NDArray[Any]:
    """Return an array of the device as a new one."""
    out = np.empty(array.shape, dtype)
    work.download(array, out)
    return out
