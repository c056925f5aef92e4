"""What a plan of launches needs of a device: memory, launches of kernels by name, copies there and back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

from numpy.typing import NDArray

from beltscape.kernels.cuda.constants import ConstantCache
from beltscape.kernels.cuda.memory import DeviceArray, MemoryPool

SHARED_BYTES = 48 << 10
"""Shared memory of a block that every GPU gives; more needs a driver's leave."""

Size = tuple[int, int, int]
"""Along x, y and z."""


class Launch(NamedTuple):
    """A kernel by its name with its arguments: arrays of the device, int and float, as the kernel declares them."""

    kernel: str
    grid: Size
    block: Size
    arguments: Sequence[Any]
    shared_bytes: int


class GpuDevice(Protocol):
    """A GPU, or an emulated one. Copies and launches of one stream run in their order; all raise DeviceError."""

    name: str
    memory: MemoryPool
    constants: ConstantCache

    def open_stream(self) -> Any:
        """Return a stream for this thread."""
        ...

    def close_stream(self, stream: Any) -> None:
        """Note that a stream is no longer used; what it was given still runs."""
        ...

    def copy_in(self, stream: Any, host: NDArray[Any], array: DeviceArray) -> None:
        """Copy a contiguous array to the device."""
        ...

    def copy_out(self, stream: Any, array: DeviceArray, host: NDArray[Any]) -> None:
        """Copy an array of the device to a contiguous one, and wait for the copy."""
        ...

    def launch(
        self, stream: Any, kernel: str, grid: Size, block: Size, arguments: Sequence[Any], shared_bytes: int
    ) -> None:
        """Run a kernel of native/cuda by its name.

        Arguments are arrays of the device, int and float, just as the kernel declares them: nothing is converted.
        """
        ...

    def copy_within(self, stream: Any, source: DeviceArray, array: DeviceArray) -> None:
        """Copy an array of the device to another one of the same size."""
        ...

    def make_graph(self, launches: Sequence[Launch]) -> Any:
        """Return launches, one after the other, as a graph; their arrays must live as long as it does."""
        ...

    def launch_graph(self, stream: Any, graph: Any) -> None:
        """Run all launches of a graph."""
        ...

    def finish(self, events: Sequence[Any]) -> None:
        """Wait on the processor for events."""
        ...

    def record(self, stream: Any) -> Any:
        """Return an event after all that the stream was given."""
        ...

    def wait(self, stream: Any, event: Any) -> None:
        """Let the stream wait for an event of another one."""
        ...


def blocks_of(count: int, of: int) -> int:
    """Return how many blocks of ``of`` cover ``count``."""
    return -(-count // of)
