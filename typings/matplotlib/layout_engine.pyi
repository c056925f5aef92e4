"""Engines that position the axes of a figure before it is drawn."""

from .figure import Figure

class LayoutEngine:
    def execute(self, fig: Figure) -> None: ...
