"""The scale of a plot's axis."""

from collections.abc import Callable

_Formatter = Callable[[float, int], str]

class Axis:
    def get_major_formatter(self) -> _Formatter: ...
    def set_major_formatter(self, formatter: _Formatter) -> None: ...
    def set_minor_formatter(self, formatter: _Formatter) -> None: ...
