"""The display of results: a picture by ``.plot()``, and picture and numbers together in a notebook."""

from __future__ import annotations

from importlib import import_module
from typing import Any


class Displayed:
    """A result that can be plotted.

    The drawing itself is done by `beltscape.report.notebook`. It is loaded by name on the first call, because results
    stand below reports and do not depend on them.
    """

    __slots__ = ()

    def plot(self) -> Any:
        """Return a Matplotlib figure of the result; save it with ``figure.savefig(path)``."""
        return import_module("beltscape.report.notebook").plot(self)

    def _repr_html_(self) -> str:
        """Return the result as a notebook shows it: its line of text and its picture."""
        return import_module("beltscape.report.notebook").render_html(self)
