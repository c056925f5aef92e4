"""Figures as PNG."""

from collections.abc import Mapping
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ..figure import Figure
from ..font_manager import FontProperties

class RendererAgg:
    width: float
    height: float
    dpi: float
    def __init__(self, width: float, height: float, dpi: float) -> None: ...
    def get_text_width_height_descent(
        self, s: str, prop: FontProperties, ismath: Any
    ) -> tuple[float, float, float]: ...
    def draw_text(
        self,
        gc: Any,
        x: float,
        y: float,
        s: str,
        prop: FontProperties,
        angle: float,
        ismath: Any = ...,
        mtext: Any = ...,
    ) -> None: ...
    def draw_image(self, gc: Any, x: float, y: float, im: NDArray[np.uint8]) -> None: ...

class FigureCanvasAgg:
    figure: Figure
    renderer: RendererAgg
    _lastKey: tuple[float, float, float] | None
    def get_renderer(self) -> RendererAgg: ...
    def get_width_height(self, *, physical: bool = ...) -> tuple[int, int]: ...
    def __init__(self, figure: Figure) -> None: ...
    def print_png(self, filename_or_obj: IO[bytes], *, metadata: Mapping[str, Any] | None = ...) -> None: ...
