"""Memory of a device: blocks that a pool hands out again, up to a bound, and the arrays in them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import count
from math import prod
from threading import Lock
from typing import Any, Protocol

import numpy as np

MOST_BYTES = 12 << 30
"""Bound of a pool without a GPU: a frame takes 980 bytes a pixel, and 1400 with its graphs (emulated, preset
``standard``; the more pixels are refined, the more). Two frames of 2448 × 2048 px in flight fit, one of them with its
graphs."""
_GRAIN = 1 << 16
"""Blocks are multiples of this, so that arrays of nearly one size share them."""


class DeviceError(Exception):
    """The device failed: it is lost, has no memory left, or a kernel went wrong."""


class MemoryExceededError(DeviceError):
    """The arrays in use exceed what the pool may take of the device."""


class BlockOwner(Protocol):
    """What a block returns to."""

    def give_back(self, block: MemoryBlock) -> None:
        """Note that a block is free; called by the garbage collector in any thread."""
        ...


class RawMemory(Protocol):
    """Memory as a device gives it."""

    @property
    def address(self) -> int:
        """Of its first byte."""
        ...


_serials = count()


class MemoryBlock:
    """Memory that returns to its owner when nothing refers to it any more."""

    __slots__ = ("events", "owner", "raw", "serial", "size")

    def __init__(self, owner: BlockOwner, raw: Any, size: int, events: dict[int, Any]) -> None:
        self.raw = raw
        self.size = size
        self.events = events
        """Stream (its ``id``) → the event after its last use of the block, for which other streams wait."""
        self.owner = owner
        """The pool, or the graph whose results lie in it."""
        self.serial = next(_serials)
        """Of this use of the memory; no other block has it."""

    def __del__(self) -> None:
        self.owner.give_back(self)


@dataclass(frozen=True, slots=True)
class DeviceArray:
    """An array in a block, which the processor cannot read."""

    block: MemoryBlock
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    offset: int = 0
    """Of its first byte in the block."""

    @property
    def address(self) -> int:
        """Where it begins in the device's memory."""
        return int(self.block.raw.address) + self.offset

    @property
    def size(self) -> int:
        """Number of elements."""
        return prod(self.shape)

    @property
    def nbytes(self) -> int:
        """Its bytes."""
        return self.size * self.dtype.itemsize

    def part(self, i: int) -> DeviceArray:
        """Return the i-th part along the first axis, in the same memory."""
        size = prod(self.shape[1:]) * self.dtype.itemsize
        return replace(self, shape=self.shape[1:], offset=self.offset + i % self.shape[0] * size)

    def rows(self, first: int, last: int) -> DeviceArray:
        """Return the parts ``first`` to ``last`` - 1 along the first axis, in the same memory."""
        size = prod(self.shape[1:]) * self.dtype.itemsize
        return replace(self, shape=(last - first, *self.shape[1:]), offset=self.offset + first * size)

    def viewed(self, dtype: np.dtype[Any]) -> DeviceArray:
        """Return the same bits as elements of another type of the same size."""
        return replace(self, dtype=dtype)

    def reshaped(self, shape: tuple[int, ...]) -> DeviceArray:
        """Return the same elements in another shape, in the same memory."""
        if prod(shape) != self.size:
            raise ValueError(f"an array {self.shape} has no shape {shape}")
        return replace(self, shape=shape)


@dataclass
class MemoryPool:
    """Free blocks by size. What is in use and what is free together never exceed ``bound`` bytes."""

    allocate: Callable[[int], Any]
    """Returns memory of a size, or raises DeviceError."""
    free: Callable[[Any, list[Any]], None]
    """Frees memory after some events."""
    bound: int = MOST_BYTES
    grain: int = _GRAIN
    prepare: Callable[[Any], None] = lambda _: None
    """Called with memory before each use."""
    reclaim: Callable[[], None] = lambda: None
    """Called before a take fails; gives up blocks that could be done without."""
    allocated: int = 0
    """Bytes that the pool has of the device."""
    in_use: int = 0
    peak: int = 0
    """Most bytes in use so far."""
    _free: dict[int, list[tuple[Any, dict[int, Any]]]] = field(default_factory=dict)
    _returned: deque[tuple[Any, int, dict[int, Any]]] = field(default_factory=deque)
    _lock: Lock = field(default_factory=Lock)

    def take(self, size: int) -> MemoryBlock:
        """Return a block of at least ``size`` bytes; its events are those to wait for.

        Raises
        ------
        MemoryExceededError
            Where the bound would be exceeded.
        DeviceError
            Where the device has no memory left.
        """
        size = max(self.grain, -(-size // self.grain) * self.grain)
        with self._lock:
            self._collect()
            found = self._free.get(size)
            raw, events = found.pop() if found else (self._allocate(size), {})
            self.in_use += size
            self.peak = max(self.peak, self.in_use)
        self.prepare(raw)
        return MemoryBlock(self, raw, size, events)

    def give_back(self, block: MemoryBlock) -> None:
        """Note that a block is free; called by the garbage collector in any thread, so it takes no lock."""
        self._returned.append((block.raw, block.size, block.events))

    def trim(self) -> None:
        """Return all free blocks to the device."""
        with self._lock:
            self._collect()
            self._trim()

    def _collect(self) -> None:
        while self._returned:
            raw, size, events = self._returned.popleft()
            self.in_use -= size
            self._free.setdefault(size, []).append((raw, events))

    def _allocate(self, size: int) -> Any:
        reason = f"the arrays of a frame exceed the bound of {self.bound >> 20} MB of the GPU's memory"
        for make_room in (lambda: None, self._trim, self._reclaim):
            make_room()
            if self.allocated + size > self.bound:
                continue
            try:
                raw = self.allocate(size)
            except DeviceError as error:
                if "OUT_OF_MEMORY" not in str(error):
                    raise
                reason = f"{error}: {self.allocated >> 20} MB of the GPU's are held here, the rest by others"
                continue
            self.allocated += size
            return raw
        raise MemoryExceededError(reason)

    def _reclaim(self) -> None:
        self.reclaim()
        self._collect()
        self._trim()

    def _trim(self) -> None:
        for size, blocks in self._free.items():
            for raw, events in blocks:
                self.free(raw, list(events.values()))
                self.allocated -= size
        self._free.clear()
