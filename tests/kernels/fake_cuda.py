"""cuda-core as far as the CUDA back end calls it, on the emulated GPU: what it is given is checked, and computed.

A launch passes addresses and numbers, whose types a GPU does not check; here they are held against the kernels' own
declarations in native/cuda.
"""

from __future__ import annotations

import ctypes
import re
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

CUDA = Path(__file__).parents[2] / "native" / "cuda"
FREE_BYTES = 12 << 20
"""Of the fake GPU's memory."""
_TYPES = {
    "unsigned long long": np.uint64, "unsigned char": np.uint8,
    "unsigned short": np.uint16, "int": np.int32, "float": np.float32, "double": np.float64
}  # fmt: skip


def declared_kernels() -> dict[str, list[tuple[type, bool]]]:
    """Kernel → its parameters: type, and whether it is a pointer."""
    found = {}
    for path in CUDA.glob("*.cuh"):
        for name, text in re.findall(r'extern "C" __global__ void (\w+)\(([^)]*)\)', path.read_text()):
            parameters = [each.split() for each in text.replace("*", " * ").split(",")]
            found[name] = [
                (_TYPES[" ".join(word for word in words[:-1] if word not in ("const", "*"))], "*" in words)
                for words in parameters
            ]
    return found


class FakeGpu:
    """Memory and launches; ``failure`` is what the next launches raise."""

    def __init__(self) -> None:
        self.buffers: dict[int, np.ndarray] = {}
        self.streams = 0
        self.events = 0
        self.launches: list[str] = []
        self.failure: Exception | None = None
        self.kernels = declared_kernels()

    def array(self, address: int, dtype: type) -> np.ndarray:
        """What lies in the memory from an address to its buffer's end."""
        assert isinstance(address, int)
        start = next(at for at, memory in self.buffers.items() if at <= address < at + memory.nbytes)
        memory = self.buffers[start][address - start :]
        return memory[: memory.nbytes // np.dtype(dtype).itemsize * np.dtype(dtype).itemsize].view(dtype)

    def launch(self, stream: Any, config: Any, kernel: str, *arguments: Any) -> None:
        if self.failure:
            raise self.failure
        if isinstance(stream, GraphBuilder):
            assert stream.state == "building"
            stream.launches.append((config, kernel, *arguments))
            return
        self.launches.append(kernel)
        ready = []
        for given, (dtype, is_pointer) in zip(arguments, self.kernels[kernel], strict=True):
            if is_pointer:
                ready.append(self.array(given, dtype))
            else:
                assert type(given) is dtype, (kernel, len(ready), type(given), dtype)
                ready.append(given.item())
        emulated = getattr(import_module("beltscape.kernels._emulated"), kernel)
        emulated(config.grid, config.block, config.shmem_size, 0, ready)


class Stream:
    """A stream, of which the GPU counts those that are open."""

    handle = 7

    def __init__(self, gpu: FakeGpu) -> None:
        self._gpu = gpu
        gpu.streams += 1

    def sync(self) -> None:
        if self._gpu.failure:
            raise self._gpu.failure

    def record(self) -> Event:
        self._gpu.events += 1
        return Event()

    def wait(self, event: Event) -> None:
        assert isinstance(event, Event)


class Event:
    """Something that has happened: nothing runs later than it is called."""

    def sync(self) -> None: ...


class Buffer:
    """Memory of the GPU, full of NaN."""

    def __init__(self, gpu: FakeGpu, size: int) -> None:
        memory = np.full(size, 0xFF, np.uint8)
        self.handle = memory.ctypes.data
        self._gpu = gpu
        gpu.buffers[self.handle] = memory

    def close(self, stream: Any = None) -> None:
        del self._gpu.buffers[self.handle]


class LaunchConfig:
    def __init__(self, *, grid: Any, block: Any, shmem_size: int = 0) -> None:
        self.grid, self.block, self.shmem_size = grid, block, shmem_size


class GraphBuilder:
    """A graph that is captured: launches given to it do not run."""

    def __init__(self, gpu: FakeGpu) -> None:
        self._gpu = gpu
        self.launches: list[tuple[Any, ...]] = []
        self.state = "new"

    def begin_building(self) -> GraphBuilder:
        assert self.state == "new"
        self.state = "building"
        return self

    def end_building(self) -> GraphBuilder:
        assert self.state == "building"
        self.state = "ended"
        return self

    def complete(self) -> GraphBuilder:
        assert self.state == "ended"
        self.state = "complete"
        return self

    def launch(self, stream: Stream) -> None:
        assert self.state == "complete"
        for each in self.launches:
            self._gpu.launch(stream, *each)


class Code:
    """The compiled kernels."""

    def __init__(self, gpu: FakeGpu) -> None:
        self._gpu = gpu

    def get_kernel(self, name: str) -> str:
        assert name in self._gpu.kernels
        return name


def install(monkeypatch: Any, gpu: FakeGpu) -> None:
    """Put the fake in the place of cuda-core and its bindings."""

    class Device:
        name, arch = "Fake GPU", "90"

        def __init__(self, number: int | None = None) -> None: ...

        def set_current(self) -> None:
            if gpu.failure:
                raise gpu.failure

        def create_stream(self) -> Stream:
            return Stream(gpu)

        def create_graph_builder(self) -> GraphBuilder:
            return GraphBuilder(gpu)

        def allocate(self, size: int, *, stream: Stream) -> Buffer:
            return Buffer(gpu, size)

    def copy(to: int, source: int, size: int, stream: Any) -> tuple[int]:
        ctypes.memmove(to, source, size)
        return (0,)

    def count_free() -> tuple[int, int, int]:
        return 0, FREE_BYTES, 2 * FREE_BYTES

    core = SimpleNamespace(Device=Device, LaunchConfig=LaunchConfig, launch=gpu.launch)
    driver = SimpleNamespace(
        cuMemcpyHtoDAsync=copy, cuMemcpyDtoHAsync=copy, cuMemcpyDtoDAsync=copy, cuMemGetInfo=count_free
    )
    monkeypatch.setitem(sys.modules, "cuda.core", core)
    monkeypatch.setitem(sys.modules, "cuda.bindings", SimpleNamespace(driver=driver))
    back_end = "beltscape.kernels.cuda.cuda_device"
    monkeypatch.setattr(f"{back_end}.is_driver_present", lambda: True)
    monkeypatch.setattr(f"{back_end}.is_library_present", lambda: True)
    monkeypatch.setattr(f"{back_end}.compile_kernels", lambda _: Code(gpu))
