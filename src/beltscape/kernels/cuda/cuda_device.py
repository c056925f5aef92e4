"""A GPU of Nvidia: kernels compiled by NVRTC when the program starts, memory and launches by cuda-core."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.cuda.constants import ConstantCache
from beltscape.kernels.cuda.device import Launch, Size
from beltscape.kernels.cuda.memory import DeviceArray, DeviceError, MemoryPool
from beltscape.kernels.native import source_folder

ARCHITECTURES = ("sm_75", "sm_80", "sm_86", "sm_89", "sm_90", "sm_100")
"""Turing to Blackwell: what the tests compile for. Others compile at the plant for the GPU that is there."""

_FREE_SHARE = 0.8
"""Of the GPU's free memory, that frames may take together: the rest is for other programs."""
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


class CudaMemory:
    """Memory of a GPU."""

    __slots__ = ("address", "buffer")

    def __init__(self, buffer: Any) -> None:
        self.buffer = buffer
        self.address = int(buffer.handle)
        """Of its first byte."""


class CudaDevice:
    """One GPU. Every call has its own stream, so that calls of several threads and frames overlap."""

    def __init__(self, number: int = 0) -> None:
        if not is_library_present():
            raise KernelError(
                "the kernels cuda need cuda-core, which is not installed; run: pip install 'beltscape[gpu]'"
            )
        if not is_driver_present():
            raise KernelError(
                "there is no usable GPU: this machine has no driver of Nvidia's; "
                "install it, or unset BELTSCAPE_KERNELS"
            )
        from cuda.core import Device

        self.name = "cuda"
        try:
            self._device = Device(number)
            self._device.set_current()
            self.model: str = self._device.name
            architecture = f"sm_{self._device.arch}"
            self._memory_stream = self._device.create_stream()
            bound = int(_FREE_SHARE * _count_free_bytes())
        except Exception as error:  # no driver, no GPU, or one that other programs hold
            text = str(error).splitlines()[0]
            raise KernelError(f"there is no usable GPU: {text}; install Nvidia's driver") from error
        self.memory = MemoryPool(self._allocate, self._free, bound)
        self.constants = ConstantCache()
        self._code = compile_kernels(architecture)
        self._kernels: dict[str, Any] = {}
        self._streams: list[Any] = []

    def open_stream(self) -> Any:
        """See `beltscape.kernels.cuda.device.GpuDevice`: one that is free, or a new one."""
        with _as_device_error():
            self._device.set_current()  # of this thread
            try:
                return self._streams.pop()
            except IndexError:
                return self._device.create_stream()

    def close_stream(self, stream: Any) -> None:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        self._streams.append(stream)

    def copy_in(self, stream: Any, host: NDArray[Any], array: DeviceArray) -> None:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        from cuda.bindings import driver

        _check(driver.cuMemcpyHtoDAsync(array.address, host.ctypes.data, array.nbytes, stream.handle))

    def copy_out(self, stream: Any, array: DeviceArray, host: NDArray[Any]) -> None:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        from cuda.bindings import driver

        _check(driver.cuMemcpyDtoHAsync(host.ctypes.data, array.address, array.nbytes, stream.handle))
        self.synchronise(stream)

    def launch(
        self, stream: Any, kernel: str, grid: Size, block: Size, arguments: Sequence[Any], shared_bytes: int
    ) -> None:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        with _as_device_error():
            self._launch(stream, kernel, grid, block, arguments, shared_bytes)

    def copy_within(self, stream: Any, source: DeviceArray, array: DeviceArray) -> None:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        from cuda.bindings import driver

        _check(driver.cuMemcpyDtoDAsync(array.address, source.address, array.nbytes, stream.handle))

    def make_graph(self, launches: Sequence[Launch]) -> Any:
        """See `beltscape.kernels.cuda.device.GpuDevice`: launches that are captured, not run."""
        with _as_device_error():
            self._device.set_current()
            builder = self._device.create_graph_builder().begin_building()
            for kernel, grid, block, arguments, shared_bytes in launches:
                self._launch(builder, kernel, grid, block, arguments, shared_bytes)
            return builder.end_building().complete()

    def launch_graph(self, stream: Any, graph: Any) -> None:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        with _as_device_error():
            graph.launch(stream)

    def finish(self, events: Sequence[Any]) -> None:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        with _as_device_error():
            for event in events:
                event.sync()

    def record(self, stream: Any) -> Any:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        with _as_device_error():
            return stream.record()

    def wait(self, stream: Any, event: Any) -> None:
        """See `beltscape.kernels.cuda.device.GpuDevice`."""
        with _as_device_error():
            stream.wait(event)

    def synchronise(self, stream: Any) -> None:
        """Wait until all launches and copies so far have ended."""
        with _as_device_error():
            stream.sync()

    def _launch(
        self, where: Any, kernel: str, grid: Size, block: Size, arguments: Sequence[Any], shared_bytes: int
    ) -> None:
        """Launch a kernel in a stream, or add it to a graph."""
        from cuda.core import LaunchConfig, launch

        config = LaunchConfig(grid=grid, block=block, shmem_size=shared_bytes)
        launch(where, config, self._kernel(kernel), *map(_argument, arguments))

    def _allocate(self, size: int) -> CudaMemory:
        with _as_device_error():
            memory = CudaMemory(self._device.allocate(size, stream=self._memory_stream))
            self._memory_stream.sync()  # any stream may use it
        return memory

    def _free(self, memory: CudaMemory, events: list[Any]) -> None:
        self.finish(events)
        with _as_device_error():
            memory.buffer.close(self._memory_stream)

    def _kernel(self, name: str) -> Any:
        """Return a kernel of native/cuda."""
        if name not in self._kernels:
            self._kernels[name] = self._code.get_kernel(name)
        return self._kernels[name]


def _count_free_bytes() -> int:
    """Return the free memory of this thread's GPU."""
    from cuda.bindings import driver

    bindings: Any = driver  # whose stubs lack the function
    error, free, _ = bindings.cuMemGetInfo()
    _check((error,))
    return int(free)


def _check(result: tuple[Any, ...]) -> None:
    """Raise DeviceError where a call of the driver failed."""
    if int(result[0]):
        raise DeviceError(f"the driver answers {result[0].name}")


def _argument(given: Any) -> Any:
    """Return an argument of the type that the kernels' parameters have: a pointer, int or float."""
    if isinstance(given, DeviceArray):
        return given.address
    return np.float32(given) if isinstance(given, float | np.floating) else np.int32(given)


@contextmanager
def _as_device_error() -> Generator[None]:
    """Turn what cuda-core raises into a DeviceError."""
    try:
        yield
    except Exception as error:  # its types belong to no public module
        raise DeviceError(str(error) or type(error).__name__) from error
