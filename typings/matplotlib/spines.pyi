"""The frame of a plot."""

from collections.abc import Sequence

class SpinesProxy:
    def set_edgecolor(self, color: str) -> None: ...
    def set_visible(self, b: bool) -> None: ...

class Spines:
    def __getitem__(self, key: Sequence[str] | slice) -> SpinesProxy: ...
