"""Figures as PNG."""

from collections.abc import Mapping
from typing import IO, Any

from ..figure import Figure

class FigureCanvasAgg:
    def __init__(self, figure: Figure) -> None: ...
    def print_png(self, filename_or_obj: IO[bytes], *, metadata: Mapping[str, Any] | None = ...) -> None: ...
