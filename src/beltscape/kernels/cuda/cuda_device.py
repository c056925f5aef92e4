"""A GPU of Nvidia: kernels compiled by NVRTC when the program starts, memory and launches by cuda-core."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.cuda.device import DeviceError, Size
from beltscape.kernels.native import source_folder

ARCHITECTURES = ("sm_75", "sm_80", "sm_86", "sm_89", "sm_90", "sm_100")
"""Turing to Blackwell: what the tests compile for. Others compile at the plant for the GPU that is there."""

_SOURCE = '#include "cuda/kernels.cuh"\n'


def is_driver_present() -> bool:
    """Return whether this machine has the driver of an Nvidia GPU; takes no time where it has none."""
    try:
        ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    except OSError:
        return False
    return True


def is_library_present() -> bool:
    """Return whether cuda-core is installed (extra ``gpu``)."""
    return find_spec("cuda") is not None and find_spec("cuda.core") is not None


def compile_kernels(architecture: str, folder: Path | None = None) -> Any:
    """Return the machine code of all kernels for an architecture such as ``sm_90``; needs no GPU.

    Only fused multiply-adds that the source names are fused, and divisions and roots are rounded correctly, so that
    results are those of the processor.

    Raises
    ------
    KernelError
        With the compiler's first error.
    """
    from cuda.core import Program, ProgramOptions

    options = ProgramOptions(
        name="kernels.cu",
        arch=architecture,
        std="c++20",
        fma=False,
        ftz=False,
        prec_div=True,
        prec_sqrt=True,
        include_path=str(folder or source_folder()),
    )
    try:
        return Program(_SOURCE, "c++", options).compile("cubin")
    except Exception as error:  # NVRTC's own types belong to no public module
        lines = str(error).splitlines()
        line = next((line for line in lines if ": error" in line or ": catastrophic error" in line), lines[0])
        raise KernelError(f"the kernels do not compile for {architecture}: {line}") from error


@dataclass(frozen=True, slots=True)
class CudaArray:
    """An array in the memory of a GPU, or a part of one."""

    buffer: Any
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    offset: int = 0
    """Of its first byte in the buffer."""

    @property
    def address(self) -> int:
        """Where it begins in the GPU's memory."""
        return int(self.buffer.handle) + self.offset

    @property
    def bytes(self) -> int:
        """Its size."""
        return prod(self.shape) * self.dtype.itemsize


class CudaDevice:
    """One GPU. Every call has its own stream, so that calls of several threads overlap."""

    def __init__(self, number: int = 0) -> None:
        if not is_library_present():
            raise KernelError(
                "the kernels cuda need cuda-core, which is not installed; run: pip install 'beltscape[gpu]'"
            )
        from cuda.core import Device

        self.name = "cuda"
        self._device = Device(number)
        try:
            self._device.set_current()
            self.model: str = self._device.name
            architecture = f"sm_{self._device.arch}"
        except Exception as error:  # no driver, no GPU, or one that other programs hold
            text = str(error).splitlines()[0]
            raise KernelError(f"there is no usable GPU: {text}; install Nvidia's driver") from error
        self._code = compile_kernels(architecture)
        self._kernels: dict[str, Any] = {}

    @contextmanager
    def workspace(self) -> Generator[CudaWorkspace]:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        try:
            self._device.set_current()  # of this thread
            stream = self._device.create_stream()
        except Exception as error:
            raise DeviceError(str(error)) from error
        work = CudaWorkspace(self, stream)
        try:
            yield work
        finally:
            work.close()

    def allocate(self, size: int, stream: Any) -> Any:
        """Return a buffer of ``size`` bytes."""
        return self._device.allocate(size, stream=stream)

    def kernel(self, name: str) -> Any:
        """Return a kernel of native/cuda."""
        if name not in self._kernels:
            self._kernels[name] = self._code.get_kernel(name)
        return self._kernels[name]


class CudaWorkspace:
    """Arrays and launches in one stream; the arrays return to the GPU's memory at its end."""

    def __init__(self, device: CudaDevice, stream: Any) -> None:
        self._device = device
        self._stream = stream
        self._buffers: list[Any] = []

    def upload(self, array: NDArray[Any]) -> CudaArray:
        """See `beltscape.kernels.cuda.device.Workspace`."""
        from cuda.bindings import driver

        array = np.ascontiguousarray(array)
        copy = self.allocate(array.shape, array.dtype)
        self._check(
            driver.cuMemcpyHtoDAsync(copy.address, array.ctypes.data, copy.bytes, self._stream.handle)
        )
        return copy

    def allocate(self, shape: tuple[int, ...], dtype: DTypeLike) -> CudaArray:
        """See `beltscape.kernels.cuda.device.Workspace`."""
        size = int(prod(shape)) * np.dtype(dtype).itemsize
        with _as_device_error():
            buffer = self._device.allocate(max(size, 1), self._stream)
        self._buffers.append(buffer)
        return CudaArray(buffer, tuple(shape), np.dtype(dtype))

    def part(self, array: CudaArray, i: int) -> CudaArray:
        """See `beltscape.kernels.cuda.device.Workspace`."""
        size = prod(array.shape[1:]) * array.dtype.itemsize
        return CudaArray(array.buffer, array.shape[1:], array.dtype, array.offset + i * size)

    def launch(self, kernel: str, grid: Size, block: Size, *arguments: Any, shared_bytes: int = 0) -> None:
        """See `beltscape.kernels.cuda.device.Workspace`."""
        from cuda.core import LaunchConfig, launch

        with _as_device_error():
            config = LaunchConfig(grid=grid, block=block, shmem_size=shared_bytes)
            launch(self._stream, config, self._device.kernel(kernel), *map(_argument, arguments))

    def download(self, array: CudaArray, out: NDArray[Any]) -> None:
        """See `beltscape.kernels.cuda.device.Workspace`."""
        from cuda.bindings import driver

        into = out if out.flags.c_contiguous else np.empty(out.shape, out.dtype)
        if into.nbytes != array.bytes:
            raise KernelError(f"a result of {array.bytes} bytes does not fit an array of {into.nbytes}")
        self._check(
            driver.cuMemcpyDtoHAsync(into.ctypes.data, array.address, array.bytes, self._stream.handle)
        )
        self.wait()
        if into is not out:
            out[...] = into

    def wait(self) -> None:
        """Wait until all launches and copies so far have ended."""
        with _as_device_error():
            self._stream.sync()

    def close(self) -> None:
        """Return the memory; a GPU that is lost has none to return."""
        for buffer in self._buffers:
            buffer.close(self._stream)
        self._stream.close()

    @staticmethod
    def _check(result: tuple[Any, ...]) -> None:
        """Raise DeviceError where a call of the driver failed."""
        if int(result[0]):
            raise DeviceError(f"{result[0].name} when copying")


def _argument(given: Any) -> Any:
    """Return an argument of the type that the kernels' parameters have: a pointer, int or float."""
    if isinstance(given, CudaArray):
        return given.address
    return np.float32(given) if isinstance(given, float | np.floating) else np.int32(given)


@contextmanager
def _as_device_error() -> Generator[None]:
    """Turn what cuda-core raises into a DeviceError."""
    try:
        yield
    except Exception as error:  # its types belong to no public module
        raise DeviceError(str(error) or type(error).__name__) from error
