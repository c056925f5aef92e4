"""Objects with arrays between two processes: their outline through a pipe, the arrays through shared memory.

The outline is the object's pickle without its large arrays (protocol 5, PEP 574); these are copied once, into memory
that both processes have mapped. A block of memory serves one direction and one object at a time.
"""

from __future__ import annotations

import hashlib
import mmap
import os
import pickle
import struct
from collections import OrderedDict
from collections.abc import Sequence
from functools import cached_property
from typing import IO, Any, Generic, TypeVar

_LENGTH = struct.Struct("<Q")
"""Before every message on a pipe: its length in bytes."""
_ALIGNMENT = 64
"""Arrays begin at multiples of this many bytes, as vector instructions like them."""
_LEAST_BYTES = 1 << 20
"""Size of a new block."""

Place = tuple[int, int]
"""Offset and size of an array in its block, bytes."""


class Block:
    """Memory that two processes have mapped: a file without a name, or one of the temporary folder."""

    def __init__(self, file: int) -> None:
        """``file`` is the open file; the block owns it."""
        self._file = file
        self._map: mmap.mmap | None = None

    def write(self, buffers: Sequence[pickle.PickleBuffer]) -> list[Place]:
        """Copy arrays into the block, which grows where it is too small; return their places."""
        places: list[Place] = []
        end = 0
        for buffer in buffers:
            size = buffer.raw().nbytes
            places.append((end, size))
            end += -(-size // _ALIGNMENT) * _ALIGNMENT
        view = self._view(end, may_grow=True)
        for (start, size), buffer in zip(places, buffers, strict=True):
            view[start : start + size] = buffer.raw()
        return places

    def read(self, places: Sequence[Place], *, copied: bool) -> list[bytearray | memoryview]:
        """Return the arrays at their places; those that are not ``copied`` hold until the block is written again."""
        view = self._view(max((start + size for start, size in places), default=0), may_grow=False)
        parts = [view[start : start + size] for start, size in places]
        return [bytearray(part) for part in parts] if copied else [part.toreadonly() for part in parts]

    def close(self) -> None:
        """Give the memory up; what was read without a copy keeps it until it goes."""
        self._map = None
        os.close(self._file)

    def _view(self, size: int, *, may_grow: bool) -> memoryview:
        if self._map is not None and len(self._map) >= size:
            return memoryview(self._map)
        length = os.fstat(self._file).st_size
        if length < size or not length:
            if not may_grow:
                raise EOFError("the other process announced more than it wrote")
            length = max(_LEAST_BYTES, 2 * size)
            os.ftruncate(self._file, length)
        # an array that was read without a copy keeps the former map
        self._map = mmap.mmap(self._file, length)
        return memoryview(self._map)


def send(pipe: IO[bytes], block: Block, value: object) -> None:
    """Send an object; OSError if the other process has ended."""
    buffers: list[pickle.PickleBuffer] = []
    outline = pickle.dumps(value, protocol=5, buffer_callback=buffers.append)
    message = pickle.dumps((outline, block.write(buffers)))
    pipe.write(_LENGTH.pack(len(message)))
    pipe.write(message)
    pipe.flush()


def receive(pipe: IO[bytes], block: Block, *, copied: bool) -> Any:
    """Wait for an object and return it; EOFError if the other process has ended.

    The arrays of one that is not ``copied`` are read-only and hold until the next object is received.
    """
    (length,) = _LENGTH.unpack(_read(pipe, _LENGTH.size))
    outline, places = pickle.loads(_read(pipe, length))
    return pickle.loads(outline, buffers=block.read(places, copied=copied))


def _read(pipe: IO[bytes], size: int) -> bytes:
    data = pipe.read(size)
    if len(data) < size:
        raise EOFError("the other process has ended")
    return data


Value = TypeVar("Value")
_KEPT = 16
"""Shared objects that a process keeps unpacked: a measurement has four, and another one may follow it."""
_unpacked: OrderedDict[bytes, SharedObject[Any]] = OrderedDict()
"""The shared objects that other processes sent to this one, by digest; the last one used stands last."""


class SharedObject(Generic[Value]):
    """An object that is part of many tasks: pickled once here, unpickled once in each process that receives it.

    Of shared objects with the same content a process receives the same object, so that `is` compares them there.
    """

    def __init__(self, value: Value) -> None:
        self.value = value
        """The object, which must not change."""

    @cached_property
    def _content(self) -> tuple[bytes, bytes]:
        """Return the digest and the pickle of the object."""
        data = pickle.dumps(self.value, protocol=5)
        return hashlib.blake2b(data, digest_size=16).digest(), data

    def __reduce__(self) -> tuple[Any, tuple[bytes, bytes]]:
        return _receive_shared, self._content


def _receive_shared(digest: bytes, data: bytes) -> SharedObject[Any]:
    """Return the shared object with this digest."""
    shared = _unpacked.pop(digest, None)
    if shared is None:
        shared = SharedObject(pickle.loads(data))
        shared.__dict__["_content"] = digest, data  # where it is sent on
    _unpacked[digest] = shared
    while len(_unpacked) > _KEPT:
        _unpacked.popitem(last=False)
    return shared
