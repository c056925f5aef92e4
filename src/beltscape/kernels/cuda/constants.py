"""Small arrays that every frame gives to kernels again: weights, programs, layouts, tables of addresses.

They stay on the device and are found again by their content: a frame like the one before uploads none. Addresses are
among them because the pool of `memory` hands the same blocks out in the same order.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from threading import Lock
from typing import Any

from beltscape.kernels.cuda.memory import DeviceArray

MOST_BYTES = 128 << 10
"""Of an array that is kept: the weights of the largest network are 97 KB."""
_MOST_ARRAYS = 2048
"""Kept at the same time: two frames in flight need some 1,500; each takes at least 64 KB."""

Key = tuple[str, tuple[int, ...], bytes]
"""Type, shape and content."""


class ConstantCache:
    """The arrays that were used last, for all streams of a device.

    They are only read, so that their users need not wait for each other: only for the upload. One that is dropped may
    still be read by launches before; the next user of its memory waits for the last event of every stream.
    """

    def __init__(self, most: int = _MOST_ARRAYS) -> None:
        self._most = most
        self._arrays: OrderedDict[Key, DeviceArray] = OrderedDict()
        self._last: dict[int, Any] = {}
        self._lock = Lock()

    def find(self, key: Key, upload: Callable[[], DeviceArray]) -> DeviceArray:
        """Return the array of this content, uploaded where it is not there yet."""
        with self._lock:
            array = self._arrays.get(key)
            if array is None:
                array = self._arrays[key] = upload()
                if len(self._arrays) > self._most:
                    self._drop(self._arrays.popitem(last=False)[1])
            else:
                self._arrays.move_to_end(key)
            return array

    def note_use(self, stream: int, event: Any) -> None:
        """Note the last event of a stream, after which it reads no array that it was given so far."""
        with self._lock:
            self._last[stream] = event

    def clear(self) -> None:
        """Drop all arrays."""
        with self._lock:
            for array in self._arrays.values():
                self._drop(array)
            self._arrays.clear()

    def _drop(self, array: DeviceArray) -> None:
        array.block.events.update(self._last)
