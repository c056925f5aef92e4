"""Beltscape: a few synchronised cameras over a conveyor belt become a metrology-grade 3-D sensor.

Names are loaded on first use, so that ``import beltscape`` stays fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_HOME = {
    "BeltProfile": "beltscape.core.belt.height_map",
    "BeltscapeError": "beltscape.core.errors",
    "Camera": "beltscape.core.geometry.camera",
    "DepthMap": "beltscape.core.depth",
    "FrameSet": "beltscape.core.frames",
    "HeightMap": "beltscape.core.belt.height_map",
    "PointCloud": "beltscape.core.cloud",
    "Pose": "beltscape.core.geometry.pose",
    "Rig": "beltscape.core.geometry.rig",
}

__all__ = list(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'beltscape' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
