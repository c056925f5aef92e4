"""Graphs: stretches of a frame that are recorded at their first run and then launched as a whole.

A stretch is a function of arrays and numbers whose launches depend on its arguments' shapes alone. `GraphCache` finds
its recording by `arguments.describe`, and a `Graph` that is free: one whose results nothing refers to any more. Where
all are in use, because several frames are in flight or a frame runs the stretch twice, it makes another. So a graph's
arrays keep their addresses, and what a frame still reads is never overwritten.

A result of one graph that is given to another is read where it lies; other arguments are copied to the graph's own
memory. Intermediate results of graphs that run one after the other share their memory.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.cuda.arguments import Given, describe, find_fixed
from beltscape.kernels.cuda.device import GpuDevice, Launch
from beltscape.kernels.cuda.memory import DeviceArray, DeviceError, MemoryBlock, MemoryExceededError
from beltscape.kernels.cuda.recorded_values import fill_result, make_slots, replace_given, separate
from beltscape.kernels.cuda.recording import (
    ArrayReference,
    LaunchRecorder,
    NotRecordableError,
    RecordingWorkspace,
    refer,
)
from beltscape.kernels.cuda.storage import RecordedFunction, align, find_input, plan_storage
from beltscape.kernels.cuda.workspace import Traffic, Workspace, open_workspace
from beltscape.kernels.resident import ResidentArray

MOST_RECORDINGS = 256
"""A frame of 2448 × 2048 px has some 30; lists of pixels have more, one for each of their lengths."""
_MOST_SHARE = 0.5
"""Of the device's memory that graphs hold for arguments and results; then those go that were not used for longest."""
_FLOAT = np.dtype(np.float32)


@dataclass(frozen=True)
class Scratch:
    """Memory for the intermediate results of graphs, of which one is launched at a time."""

    block: MemoryBlock
    lock: Lock = field(default_factory=Lock)
    """Held until the graph's event is noted, for which the next one waits."""


class Graph:
    """A recorded stretch with memory of its own."""

    def __init__(
        self,
        device: GpuDevice,
        work: Workspace,
        stretch: RecordedFunction,
        arrays: Sequence[Any],
        scratch: Scratch,
    ) -> None:
        self.stretch = stretch
        self.is_busy = True
        """Whether something refers to its results."""
        self.bound = [_find_owner(array) for array in arrays]
        """Of each argument the array of another graph that is read where it lies; None: it is copied."""
        self.scratch = scratch
        self._resolved: dict[int, DeviceArray] = {}
        """Results by the ``id`` of their references in the recording."""
        self._places: dict[int, int] = {}
        """Block of a result → its first byte."""
        self._input_places: dict[int, int] = {}
        """Index of a copied argument → its first byte."""
        self._numbers_place = 0
        self.own = device.memory.take(self._lay_out())
        """Memory of arguments and results."""
        self._table = work.allocate((max(1, stretch.storage.table_items),), np.uint64)
        read = {id(each.block): each.block for each in self.bound if each is not None}
        self._blocks = [self.own, scratch.block, self._table.block, *read.values()]
        """What its launches read and write."""
        self.executable = device.make_graph(
            [self._resolve_launch(each) for each in stretch.recording.launches]
        )
        work.copy_to(self._list_addresses(), self._table)

    def fits(self, arrays: Sequence[Any]) -> bool:
        """Return whether the arrays of other graphs lie where this graph reads them."""
        return all(
            bound is None or _is_in_place(each, bound) for bound, each in zip(self.bound, arrays, strict=True)
        )

    def give_back(self, block: MemoryBlock) -> None:
        """Note that nothing refers to the results any more."""
        del block
        self.is_busy = False

    def launch(self, work: Workspace, arrays: Sequence[Any], numbers: Sequence[float]) -> MemoryBlock:
        """Launch the graph for other arrays and numbers; return the block of its results.

        The graph is free once nothing refers to that block.
        """
        lease = MemoryBlock(self, self.own.raw, self.own.size, self.own.events)
        work.use(self._blocks)
        for index, place in self._input_places.items():
            array = arrays[index]
            target = DeviceArray(lease, array.shape, array.dtype, place)
            source = array.find_on_device()
            work.copy_to(array.on_host() if source is None else source, target)
            if source is None:
                array.adopt(target)
        if numbers:
            target = DeviceArray(self.own, (len(numbers),), _FLOAT, self._numbers_place)
            _place_numbers(numbers, target, work)
        work.launch_graph(self.executable)
        return lease

    def drop(self, device: GpuDevice) -> None:
        """Wait until it has run, and let the next users of its constants' memory do so."""
        with suppress(DeviceError):  # a lost device runs nothing
            device.finish(list(self.own.events.values()))
        for each in self.stretch.recording.constants.values():
            each.block.events.update(self.own.events)

    def find_result(self, reference: ArrayReference, lease: MemoryBlock) -> DeviceArray:
        """Return the array of a result, in the block that `launch` returned."""
        found = self._resolved.get(id(reference))
        if found is None:
            found = self._resolved[id(reference)] = self.resolve(reference)
        if found.block is self.own:
            return DeviceArray(lease, found.shape, found.dtype, found.offset)
        return found

    def resolve(self, reference: ArrayReference) -> DeviceArray:
        """Return this graph's array for one of the recording."""
        stretch, (serial, offset, shape, dtype) = self.stretch, reference
        if serial in stretch.recording.constants:
            return DeviceArray(stretch.recording.constants[serial].block, shape, dtype, offset)
        if serial in stretch.storage.tables:
            return DeviceArray(self._table.block, shape, dtype, 8 * stretch.storage.tables[serial])
        if serial == stretch.numbers.serial:
            return DeviceArray(self.own, shape, dtype, self._numbers_place + offset)
        if (index := find_input(stretch.inputs, reference)) is not None:
            shift, bound = offset - stretch.inputs[index].offset, self.bound[index]
            block = self.own if bound is None else bound.block
            place = self._input_places[index] if bound is None else bound.offset
            return DeviceArray(block, shape, dtype, place + shift)
        if serial in self._places:
            return DeviceArray(self.own, shape, dtype, self._places[serial] + offset)
        return DeviceArray(self.scratch.block, shape, dtype, stretch.storage.scratch[serial] + offset)

    def _lay_out(self) -> int:
        """Give copied arguments, numbers and results their places; return the bytes of all."""
        storage, size = self.stretch.storage, 0
        for index, reference in enumerate(self.stretch.inputs):
            if storage.used_inputs[index] and self.bound[index] is None:
                self._input_places[index], size = size, size + align(reference.nbytes)
        self._numbers_place, size = size, size + align(self.stretch.numbers.nbytes)
        for serial, nbytes in storage.outputs.items():
            self._places[serial], size = size, size + align(nbytes)
        return size

    def _list_addresses(self) -> NDArray[np.uint64]:
        addresses = np.zeros(self._table.shape, np.uint64)
        for serial, first in self.stretch.storage.tables.items():
            for i, reference in enumerate(self.stretch.recording.tables[serial]):
                addresses[first + i] = self.resolve(reference).address
        return addresses

    def _resolve_launch(self, launch: Launch) -> Launch:
        arguments = [
            self.resolve(each) if isinstance(each, ArrayReference) else each for each in launch.arguments
        ]
        return launch._replace(arguments=arguments)


def _find_owner(array: ResidentArray) -> DeviceArray | None:
    """Return an array that lies in a graph's memory, in a block that lives as long as the graph; else None."""
    found = array.find_on_device()
    if found is None or not isinstance(found.block.owner, Graph):
        return None
    return DeviceArray(found.block.owner.own, found.shape, found.dtype, found.offset)


def _is_in_place(array: ResidentArray, bound: DeviceArray) -> bool:
    """Return whether an array lies in a graph's memory where another graph reads it."""
    found = array.find_on_device()
    return (
        found is not None
        and found.offset == bound.offset
        and isinstance(found.block.owner, Graph)
        and found.block.owner.own is bound.block
    )


def _place_numbers(numbers: Sequence[Any], target: DeviceArray, work: Workspace) -> None:
    """Copy numbers of the processor and of the device to the first elements of an array of the device."""
    on_device = [isinstance(each, ResidentArray) for each in numbers]
    if not all(on_device):
        own = [0 if there else each for each, there in zip(numbers, on_device, strict=True)]
        work.copy_to(np.array(own, np.float32), target.rows(0, len(own)))
    for i, each in enumerate(numbers):
        if isinstance(each, ResidentArray):
            work.copy_to(each.on_device(work.upload), target.part(i))


@dataclass
class GraphCounts:
    """What a cache did so far."""

    recorded: int = 0
    """Functions that ran and were recorded."""
    made: int = 0
    """Graphs that were made of recordings."""
    replayed: int = 0
    """Launches of graphs."""
    refused: dict[str, str] = field(default_factory=dict)
    """Function that cannot be recorded → why."""


class GraphCache:
    """The recordings and graphs of a device."""

    def __init__(self, device: GpuDevice, traffic: Traffic) -> None:
        self.counts = GraphCounts()
        self._device = device
        self._traffic = traffic
        self._stretches: dict[Hashable, RecordedFunction | None] = {}
        """None for a function that cannot be recorded."""
        self._graphs: dict[Hashable, list[Graph]] = {}
        """Those that were used last stand last."""
        self._scratch: dict[int, list[Scratch]] = {}
        """Number of a graph among those of its stretch → memory for intermediate results."""
        self._lock = Lock()
        device.memory.reclaim = self.drop_graphs

    def replay(self, resident: Any, function: Callable[..., Any], given: Sequence[Any]) -> Any:
        """Return ``function(*given)``, see `beltscape.kernels.Kernels.replay`."""
        found = Given()
        key: tuple[Hashable, ...] = function, *(describe(each, found) for each in given)
        found.arrays = [
            each if isinstance(each, ResidentArray) else resident.keep(each) for each in found.arrays
        ]
        places = [each.identity for each in found.arrays]
        key = *key, *(places.index(each) for each in places)
        with self._lock:
            is_known, stretch = key in self._stretches, self._stretches.get(key)
        if not is_known:
            return self._record(resident, key, function, given, found)
        if stretch is None or (graph := self._take(key, stretch, found.arrays)) is None:
            return function(*given)
        with graph.scratch.lock, open_workspace(self._device, self._traffic) as work:
            lease = graph.launch(work, found.arrays, found.numbers)
        self.counts.replayed += 1

        def find(reference: ArrayReference) -> DeviceArray:
            return graph.find_result(reference, lease)

        return fill_result(stretch.result, resident, found, find, stretch.fixed)

    def clear(self) -> None:
        """Drop all graphs and recordings."""
        with self._lock:
            self._stretches.clear()
        self.drop_graphs()

    def drop_graphs(self) -> None:
        """Drop all graphs; what refers to their results may still be read."""
        with self._lock:
            graphs = [each for several in self._graphs.values() for each in several]
            self._graphs.clear()
            self._scratch.clear()
        for graph in graphs:
            graph.drop(self._device)

    def _record(
        self, resident: Any, key: Hashable, function: Callable[..., Any], given: Sequence[Any], found: Given
    ) -> Any:
        """Return what the function returns, and note its launches."""
        arrays = [each.on_device(resident.upload) for each in found.arrays]
        stretch = result = None
        blocks: dict[int, DeviceArray] = {}
        with open_workspace(self._device, self._traffic, RecordingWorkspace) as work:
            recorder = LaunchRecorder(resident, work)
            inputs = separate(found.arrays, arrays, work)
            numbers = work.copy_argument(np.zeros(len(found.numbers) + 1, np.float32))
            _place_numbers(found.numbers, numbers, work)
            try:
                returned = function(*replace_given(given, recorder, inputs, numbers))
                result = make_slots(returned, recorder, inputs, numbers, blocks)
            except NotRecordableError as error:
                self.counts.refused[function.__qualname__] = str(error)
            else:
                references = [refer(each) for each in inputs]
                storage = plan_storage(work.recording, references, map(refer, blocks.values()))
                fixed = set[int]()
                find_fixed(result, fixed)
                stretch = RecordedFunction(
                    work.recording,
                    references,
                    refer(numbers),
                    result,
                    found.retained,
                    storage,
                    frozenset(fixed),
                )
        self._note(key, stretch)
        if stretch is None:
            return function(*given)

        def find(reference: ArrayReference) -> DeviceArray:
            block = blocks[reference.serial].block
            return DeviceArray(block, reference.shape, reference.dtype, reference.offset)

        return fill_result(result, resident, found, find)

    def _note(self, key: Hashable, stretch: RecordedFunction | None) -> None:
        """Note a recording; all are dropped where they are too many, because what is recorded changes for good."""
        if len(self._stretches) >= MOST_RECORDINGS:
            self.clear()
        with self._lock:
            self._stretches[key] = stretch
            self.counts.recorded += stretch is not None

    def _take(self, key: Hashable, stretch: RecordedFunction, arrays: Sequence[Any]) -> Graph | None:
        """Return a graph that is free, a new one if need be; None where there is no memory for it."""
        with self._lock:
            graphs = self._graphs.get(key, [])
            for graph in graphs:
                if not graph.is_busy and graph.fits(arrays):
                    graph.is_busy = True
                    self._graphs[key] = self._graphs.pop(key)
                    return graph
            number = len(graphs)
        try:
            scratch = self._take_scratch(number, stretch.storage.scratch_bytes)
            with open_workspace(self._device, self._traffic) as work:
                graph = Graph(self._device, work, stretch, arrays, scratch)
        except MemoryExceededError:
            return None
        with self._lock:
            self._graphs.setdefault(key, []).append(graph)
            self.counts.made += 1
            dropped = self._drop_oldest()
        for each in dropped:
            each.drop(self._device)
        return graph

    def _take_scratch(self, number: int, size: int) -> Scratch:
        """Return memory for intermediate results, which graphs of this number share: each waits for the others."""
        with self._lock:
            found = next((each for each in self._scratch.get(number, ()) if each.block.size >= size), None)
        if found is None:
            found = Scratch(self._device.memory.take(size))
            with self._lock:
                self._scratch.setdefault(number, []).append(found)
        return found

    def _drop_oldest(self) -> list[Graph]:
        """Return the graphs that take too much memory and are not in use, taken out; the lock is held."""
        graphs = [graph for several in self._graphs.values() for graph in several]
        excess = sum(graph.own.size for graph in graphs) - int(_MOST_SHARE * self._device.memory.bound)
        dropped: list[Graph] = []
        for graph in graphs:
            if excess > 0 and not graph.is_busy:
                dropped.append(graph)
                excess -= graph.own.size
        for several in self._graphs.values():
            several[:] = [graph for graph in several if graph not in dropped]
        return dropped
