"""A stretch of a frame as the list of its launches: what a graph is made of.

While a function is recorded, its kernels run as ever. The recording notes every launch with its arrays, not by their
addresses but by the blocks in which they lie, because a graph has memory of its own (`graphs`). What the function
copies to the device is taken to be the same at every frame: weights, windows, programs of expressions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import prod
from threading import Lock
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

from beltscape.kernels.cuda.constants import MOST_BYTES as CONSTANT_BYTES
from beltscape.kernels.cuda.device import GpuDevice, Launch, Size
from beltscape.kernels.cuda.memory import DeviceArray, DeviceError
from beltscape.kernels.cuda.workspace import Traffic, Workspace
from beltscape.kernels.resident import ResidentArray


class NotRecordableError(Exception):
    """A function does what a graph cannot: reads on the processor, or calls a kernel that the device lacks."""


class ArrayReference(NamedTuple):
    """An array by the block in which it lies."""

    serial: int
    """Of the block, see `beltscape.kernels.cuda.memory.MemoryBlock`."""
    offset: int
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    @property
    def nbytes(self) -> int:
        """Its bytes."""
        return prod(self.shape) * self.dtype.itemsize


def refer(array: DeviceArray) -> ArrayReference:
    """Return the reference to an array."""
    return ArrayReference(array.block.serial, array.offset, array.shape, array.dtype)


@dataclass
class LaunchList:
    """The launches of a function, and what their arrays are."""

    launches: list[Launch] = field(default_factory=list)
    """In their order; arrays are `ArrayReference`."""
    sizes: dict[int, int] = field(default_factory=dict)
    """Block that the function allocates → its bytes."""
    tables: dict[int, list[ArrayReference]] = field(default_factory=dict)
    """Block of a table of addresses → the arrays."""
    constants: dict[int, DeviceArray] = field(default_factory=dict)
    """Block → an array whose content is the same at every frame."""

    def list_references(self, launch: Launch) -> list[ArrayReference]:
        """Return the arrays that a launch reads or writes, those in its tables of addresses included."""
        found: list[ArrayReference] = []
        for each in launch.arguments:
            if isinstance(each, ArrayReference):
                found += [each, *self.tables.get(each.serial, ())]
        return found


class RecordingWorkspace(Workspace):
    """A workspace that notes what it does."""

    def __init__(self, device: GpuDevice, stream: Any, traffic: Traffic) -> None:
        super().__init__(device, stream, traffic)
        self.recording = LaunchList()

    def copy_argument(self, source: NDArray[Any] | DeviceArray) -> DeviceArray:
        """Return a copy of an array that the function is given."""
        copy = super().allocate(source.shape, source.dtype)
        self.copy_to(source, copy)
        return copy

    def upload(self, array: NDArray[Any] | ResidentArray) -> DeviceArray:
        """See `Workspace.upload`; large arrays of the processor belong to one frame and are refused."""
        if isinstance(array, np.ndarray) and array.nbytes > CONSTANT_BYTES:
            raise NotRecordableError(f"an array of the processor {array.shape} is copied to the GPU")
        return super().upload(array)

    def upload_all(self, arrays: Sequence[NDArray[Any] | ResidentArray]) -> DeviceArray:
        """See `Workspace.upload_all`; the table is this call's own, because a graph has other addresses."""
        places = [self.upload(array) for array in arrays]
        table = self._copy(np.array([place.address for place in places], np.uint64))
        self.recording.tables[table.block.serial] = [refer(place) for place in places]
        return table

    def allocate(self, shape: tuple[int, ...], dtype: DTypeLike) -> DeviceArray:
        """See `Workspace.allocate`."""
        array = super().allocate(shape, dtype)
        self.recording.sizes[array.block.serial] = array.nbytes
        return array

    def launch(self, kernel: str, grid: Size, block: Size, *arguments: Any, shared_bytes: int = 0) -> None:
        """See `Workspace.launch`."""
        super().launch(kernel, grid, block, *arguments, shared_bytes=shared_bytes)
        noted = [refer(each) if isinstance(each, DeviceArray) else each for each in arguments]
        self.recording.launches.append(Launch(kernel, grid, block, noted, shared_bytes))

    def download(self, array: DeviceArray, out: NDArray[Any]) -> None:
        """See `Workspace.download`; the processor decides nothing within a graph."""
        del out
        raise NotRecordableError(f"an array of the GPU {array.shape} is read on the processor")

    def read_constant(self, array: DeviceArray) -> NDArray[Any]:
        """See `Workspace.read_constant`."""
        out = np.empty(array.shape, array.dtype)
        super().download(array, out)
        return out

    def _find_constant(self, array: NDArray[Any]) -> DeviceArray:
        found = super()._find_constant(array)
        self.recording.constants[found.block.serial] = found
        return found


class LaunchRecorder:
    """Kernels that run and are recorded; what `beltscape.kernels.resident.ResidentOperations` asks for."""

    def __init__(self, resident: Any, work: RecordingWorkspace) -> None:
        self.name: str = resident.name
        self.pixels_at_once: int = resident.pixels_at_once
        self.recording = work.recording
        self._find_plan: Callable[[str, Any], Any] = resident.find_plan
        self._work = work
        self._lock = Lock()

    def run(
        self, kernel: str, given: Sequence[Any], out: Sequence[NDArray[Any]], threads: int
    ) -> Sequence[NDArray[Any]]:
        """See `beltscape.kernels.backend.Backend`; the results are resident arrays of this recorder."""
        del threads
        plan = self._find_plan(kernel, given)
        if plan is None:
            raise NotRecordableError(f"the GPU lacks the kernel {kernel}")
        self._compute(given)
        with self._lock:
            results = plan(self._work, given, out)
            self._work.close()  # of this call: what it no longer needs is free for the next
        return [cast("NDArray[Any]", ResidentArray.from_device(each, self)) for each in results]

    def _compute(self, value: Any) -> None:
        """Compute the expressions among a kernel's input, which are launches of their own."""
        if isinstance(value, ResidentArray):
            value.on_device(self.upload)
        elif isinstance(value, Sequence) and not isinstance(value, str):
            each: Any
            for each in value:
                self._compute(each)

    def keep(self, array: NDArray[Any]) -> NDArray[Any]:
        """See `beltscape.kernels.cuda.backend.ResidentBackend.keep`."""
        if isinstance(array, ResidentArray):
            array.mark_reused()
            return array
        return cast("NDArray[Any]", ResidentArray.from_host(array, self))

    def upload(self, array: NDArray[Any]) -> DeviceArray:
        """Return a copy on the device of a small array of the processor."""
        with self._lock:
            found = self._work.upload(array)
            self._work.close()
        return found

    def download(self, array: DeviceArray) -> NDArray[Any]:
        """Refuse, see `RecordingWorkspace.download`."""
        raise NotRecordableError(f"an array of the GPU {array.shape} is read on the processor")

    def give_up(self, error: DeviceError) -> None:
        """Pass the failure on."""
        raise error
