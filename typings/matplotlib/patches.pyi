"""Filled shapes."""

from typing import Any

class Patch: ...

class Rectangle(Patch):
    def __init__(self, xy: tuple[float, float], width: float, height: float, **style: Any) -> None: ...
