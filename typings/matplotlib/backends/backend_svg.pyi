"""Figures as SVG."""

from collections.abc import Mapping
from typing import IO, Any

from ..figure import Figure

class FigureCanvasSVG:
    def __init__(self, figure: Figure) -> None: ...
    def print_svg(self, filename: IO[str], *, metadata: Mapping[str, Any] | None = ...) -> None: ...
