"""Libraries that PyGObject loads at run time."""

from typing import Any

from . import GLib as GLib

Aravis: Any
"""PyGObject builds its types at run time from the library's introspection data."""
