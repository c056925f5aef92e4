from collections.abc import Sequence
from typing import Any

class Buffer:
    handle: Any
    size: int
    def close(self, stream: Stream | None = None) -> None: ...

class Stream:
    handle: Any
    def sync(self) -> None: ...
    def close(self) -> None: ...

class Kernel: ...

class ObjectCode:
    code: bytes
    def get_kernel(self, name: str) -> Kernel: ...

class Device:
    name: str
    arch: str
    def __init__(self, device_id: int | None = None) -> None: ...
    def set_current(self) -> None: ...
    def create_graph_builder(self) -> Any: ...
    def create_stream(self) -> Stream: ...
    def allocate(self, size: int, *, stream: Stream) -> Buffer: ...

class ProgramOptions:
    def __init__(
        self,
        name: str | None = ...,
        arch: str | None = ...,
        *,
        std: str | None = ...,
        fma: bool | None = ...,
        ftz: bool | None = ...,
        prec_div: bool | None = ...,
        prec_sqrt: bool | None = ...,
        include_path: str | None = ...,
    ) -> None: ...

class Program:
    def __init__(self, code: str, code_type: str, options: ProgramOptions | None = None) -> None: ...
    def compile(self, target_type: str) -> ObjectCode: ...

class LaunchConfig:
    def __init__(self, *, grid: Sequence[int], block: Sequence[int], shmem_size: int = ...) -> None: ...

def launch(stream: Stream, config: LaunchConfig, kernel: Kernel, *kernel_args: Any) -> None: ...
