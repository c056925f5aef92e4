"""Fonts."""

class FontProperties:
    def __init__(self, family: str) -> None: ...
