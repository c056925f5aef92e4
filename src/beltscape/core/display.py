"""The display of results: a picture by ``.plot()``, and picture and numbers together in a notebook."""

from __future__ import annotations

from importlib import import_module
from typing import Any

_drawings = ""
"""Name of the module that draws results."""


def register_drawings(module: str) -> None:
    """Let the functions ``plot`` and ``render_html`` of a module draw results; it is loaded when they are called."""
    global _drawings  # noqa: PLW0603
    _drawings = module


class Displayed:
    """A result that can be plotted.

    The package registers the module that draws, because results stand below reports and do not depend on them.
    """

    __slots__ = ()

    def plot(self) -> Any:
        """Return a Matplotlib figure of the result; save it with ``figure.savefig(path)``."""
        return import_module(_drawings).plot(self)

    def _repr_html_(self) -> str:
        """Return the result as a notebook shows it: its line of text and its picture."""
        return import_module(_drawings).render_html(self)
