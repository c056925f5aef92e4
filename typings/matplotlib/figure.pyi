"""Figures."""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
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
    def suptitle(self, t: str, *, x: float = ..., ha: str = ..., fontsize: float = ...) -> object: ...
    def get_size_inches(self) -> NDArray[np.float64]: ...
    def set_size_inches(self, w: float, h: float) -> None: ...
