"""Figures."""

from collections.abc import Sequence
from typing import Any, Literal

from numpy.typing import NDArray

from .axes import Axes
from .layout_engine import LayoutEngine
from .transforms import BboxBase

class Text:
    def get_window_extent(self) -> BboxBase: ...

class Figure:
    axes: Sequence[Axes]
    bbox: BboxBase
    dpi: float
    texts: Sequence[Text]
    def __init__(self, figsize: tuple[float, float], *, layout: LayoutEngine | None = ...) -> None: ...
    def set_facecolor(self, color: str) -> None: ...
    def subplots(self, nrows: int, ncols: int, *, squeeze: Literal[False]) -> NDArray[Any]: ...
    def suptitle(self, t: str) -> object: ...
