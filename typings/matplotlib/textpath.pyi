"""Outlines of letters."""

from typing import Any

from numpy.typing import NDArray

from .font_manager import FontProperties

class TextPath:
    def __init__(
        self, xy: tuple[float, float], s: str, size: float | None = ..., prop: FontProperties | None = ...
    ) -> None: ...
    def to_polygons(self) -> list[NDArray[Any]]: ...
