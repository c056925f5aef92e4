"""Arrays that stay in a GPU's memory between kernels and copy themselves to the processor where NumPy reads them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import prod
from threading import Lock
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import DTypeLike, NDArray

Copy = Callable[[Any], NDArray[Any]]
"""Copies an array of the device to the processor."""


class ResidentArray(NDArrayOperatorsMixin):
    """An array of the device, of the processor, or of both; kernels take the one and NumPy the other.

    It is read-only: results of NumPy are new arrays of the processor. Each of both copies is made once, when it is
    first needed. Where the device is lost, reading a result that only the device has raises what ``copy`` raises.
    """

    def __init__(
        self,
        shape: tuple[int, ...],
        dtype: DTypeLike,
        *,
        host: NDArray[Any] | None = None,
        device: Any = None,
        copy: Copy | None = None,
    ) -> None:
        self.shape = shape
        self.dtype = np.dtype(dtype)
        self.ndim = len(shape)
        self.size = prod(shape)
        self._host = host
        self._device = device
        self._copy = copy
        self._lock = Lock()

    @classmethod
    def from_host(cls, array: NDArray[Any]) -> ResidentArray:
        """Return the array for the device, which copies it at its first use; the array becomes read-only."""
        array = np.ascontiguousarray(array)
        array.setflags(write=False)
        return cls(array.shape, array.dtype, host=array)

    @classmethod
    def from_device(cls, array: Any, copy: Copy) -> ResidentArray:
        """Return a result of the device; ``copy`` brings it to the processor."""
        return cls(array.shape, array.dtype, device=array, copy=copy)

    def on_device(self, upload: Callable[[NDArray[Any]], Any]) -> Any:
        """Return the array of the device, uploaded at the first call."""
        with self._lock:
            if self._device is None:
                self._device = upload(self._read())
            return self._device

    def on_host(self) -> NDArray[Any]:
        """Return the array of the processor, read-only, downloaded at the first call."""
        with self._lock:
            return self._read()

    def _read(self) -> NDArray[Any]:
        if self._host is None:
            assert self._copy is not None
            self._host = self._copy(self._device)
            self._host.setflags(write=False)
        return self._host

    def astype(self, dtype: DTypeLike, *, copy: bool = True) -> Any:
        """Return the values as another type; without ``copy`` the array itself where it has that type."""
        return self if np.dtype(dtype) == self.dtype and not copy else self.on_host().astype(dtype)

    def reshape(self, *shape: Any) -> Any:
        """Return the same values in another shape, on the device where they are there."""
        wanted = shape[0] if len(shape) == 1 and isinstance(shape[0], tuple) else shape
        known = prod(n for n in wanted if n != -1)
        full = tuple(self.size // known if n == -1 else int(n) for n in wanted)
        if self._device is None or self._copy is None:
            return self.on_host().reshape(full)
        return self.from_device(self._device.reshaped(full), self._copy)

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        array = self.on_host()
        if dtype is not None and np.dtype(dtype) != array.dtype:
            return array.astype(dtype)
        return array.copy() if copy else array

    def __array_ufunc__(self, function: Any, method: str, *inputs: Any, **options: Any) -> Any:
        """Compute with the processor's arrays."""
        if any(isinstance(out, ResidentArray) for out in options.get("out", ())):
            return NotImplemented  # read-only
        return getattr(function, method)(*map(as_host, inputs), **options)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, int) and self._host is None and self._copy is not None and self.ndim > 1:
            return self.from_device(self._device.part(index), self._copy)
        return self.on_host()[index]

    def __iter__(self) -> Iterator[Any]:
        return (self[i] for i in range(len(self)))

    def __len__(self) -> int:
        return self.shape[0]

    def __getattr__(self, name: str) -> Any:
        """Return what NumPy's array has of that name: methods and attributes that are not defined here."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.on_host(), name)


def as_host(value: Any) -> Any:
    """Return a value with the processor's arrays in place of resident ones, in lists and tuples too."""
    if isinstance(value, ResidentArray):
        return value.on_host()
    if isinstance(value, list):
        return [as_host(each) for each in value]
    if isinstance(value, tuple):
        parts = map(as_host, value)
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    return value
