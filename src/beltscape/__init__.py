"""Beltscape: a few synchronised cameras over a conveyor belt become a metrology-grade 3-D sensor.

``import beltscape as bs`` gives the verbs: read a rig, reconstruct images, measure a belt. Names are loaded
on first use, so that the import stays fast; their types stand in ``__init__.pyi``.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from beltscape.core.display import register_drawings

__version__ = "0.1.0"

_HOME = {
    "Belt": "beltscape.core.empty_belt",
    "BeltProfile": "beltscape.core.height_map",
    "BeltscapeError": "beltscape.core.errors",
    "Camera": "beltscape.core.geometry.camera",
    "DepthMap": "beltscape.core.depth",
    "FlowMeter": "beltscape.api.flow",
    "FlowRecord": "beltscape.core.ledger",
    "FrameSet": "beltscape.core.frames",
    "HeightMap": "beltscape.core.height_map",
    "PointCloud": "beltscape.core.cloud",
    "Pose": "beltscape.core.geometry.pose",
    "Reconstructor": "beltscape.api.reconstruction",
    "Rig": "beltscape.core.geometry.rig",
    "calibrate": "beltscape.api.calibration",
    "demo_folder": "beltscape.api.files",
    "learn_belt": "beltscape.api.measuring",
    "measure_features": "beltscape.api.measuring",
    "measure_lumps": "beltscape.api.measuring",
    "measure_volume": "beltscape.api.measuring",
    "point_cloud": "beltscape.api.reconstruction",
    "read_belt": "beltscape.api.files",
    "read_capture": "beltscape.api.files",
    "read_depth": "beltscape.api.files",
    "read_rig": "beltscape.api.files",
    "scale_rig": "beltscape.core.geometry.rig",
    "write_belt": "beltscape.api.files",
    "write_cloud": "beltscape.api.files",
    "write_depth": "beltscape.api.files",
    "write_ply": "beltscape.api.files",
    "write_rig": "beltscape.api.files",
}

register_drawings("beltscape.report.notebook")

__all__ = list(_HOME)  # pyrefly: ignore[unresolvable-dunder-all]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'beltscape' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
