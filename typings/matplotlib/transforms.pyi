"""Rectangles in pixels."""

from typing import Any

from numpy.typing import NDArray

class BboxBase:
    @property
    def min(self) -> NDArray[Any]: ...
    @property
    def max(self) -> NDArray[Any]: ...
    @property
    def size(self) -> NDArray[Any]: ...
    @property
    def ymin(self) -> float: ...
    @property
    def ymax(self) -> float: ...
