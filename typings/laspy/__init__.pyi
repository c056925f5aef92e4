"""Types of laspy that Beltscape uses; its own leave dimensions and records unknown."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from laspy import vlrs as vlrs
from numpy.typing import NDArray

class VLR:
    user_id: str
    record_id: int
    record_data: bytes
    def __init__(
        self, user_id: str, record_id: int, description: str = ..., record_data: bytes = ...
    ) -> None: ...

class ExtraBytesParams:
    def __init__(self, name: str, type: str, description: str = ...) -> None: ...

class GlobalEncoding:
    wkt: bool

class PointFormat:
    dimension_names: Sequence[str]

class LasHeader:
    vlrs: list[VLR]
    scales: NDArray[np.float64]
    offsets: NDArray[np.float64]
    system_identifier: str
    generating_software: str
    global_encoding: GlobalEncoding
    are_points_compressed: bool
    def __init__(self, *, version: str, point_format: int) -> None: ...
    def add_extra_dims(self, params: Sequence[ExtraBytesParams]) -> None: ...

class ScaleAwarePointRecord:
    @classmethod
    def zeros(cls, point_count: int, *, header: LasHeader) -> ScaleAwarePointRecord: ...

class LasData:
    header: LasHeader
    points: ScaleAwarePointRecord
    point_format: PointFormat
    xyz: NDArray[np.float64]
    def __init__(self, header: LasHeader) -> None: ...
    def __len__(self) -> int: ...
    def __getattr__(self, name: str) -> NDArray[Any]: ...
    def __setattr__(self, name: str, value: Any) -> None: ...
    def __getitem__(self, name: str) -> NDArray[Any]: ...
    def __setitem__(self, name: str, value: NDArray[Any]) -> None: ...
    def write(self, destination: str, *, do_compress: bool) -> None: ...

def read(source: Any) -> LasData: ...
