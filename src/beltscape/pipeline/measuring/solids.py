"""The solids of a measured module: written to features.json, read and outlined for the viewer."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.checks import is_mapping
from beltscape.core.errors import InputError
from beltscape.core.geometry.pose import Pose
from beltscape.files.json_text import read_json
from beltscape.measure.features.result import MeasuredModule
from beltscape.report.drawing.scene import DRAWN_KINDS, Lines, outline_solid
from beltscape.target.module import Cube, Sphere


def make_solids_document(measured: MeasuredModule) -> list[Mapping[str, Any]]:
    """Return every solid's centre and size in the module's frame, measured if available, else nominal."""
    measured_mm = {
        (q.name, q.quantity): q.measured_mm for q in measured.quantities if np.isfinite(q.measured_mm)
    }
    length, width, thickness = measured.module.base.size_mm
    base = (measured_mm.get(("base", "length"), length), measured_mm.get(("base", "width"), width), thickness)
    solids: list[Mapping[str, Any]] = [
        {"name": "base", "kind": "box", "center_mm": (0.0, 0.0, -thickness / 2), "size_mm": base}
    ]
    for feature in measured.module.features:
        x, y = feature.center_mm
        if isinstance(feature, Sphere):
            ball = measured.spheres.get(feature.name)
            center = (x, y, feature.diameter_mm / 2)
            if ball is not None:
                center = measured.core_from_module.inverse().apply(ball.center_mm)
            radius = measured_mm.get((feature.name, "radius"), feature.diameter_mm / 2)
            size: Mapping[str, Any] = {"kind": "sphere", "center_mm": center, "diameter_mm": 2 * radius}
        elif isinstance(feature, Cube):
            edge, height = (
                measured_mm.get((feature.name, part), feature.edge_mm) for part in ("edge", "height")
            )
            size = {"kind": "box", "center_mm": (x, y, height / 2), "size_mm": (edge, edge, height)}
        else:
            height = measured_mm.get((feature.name, "height"), feature.height_mm)
            across = measured_mm.get((feature.name, "diameter"), feature.diameter_mm)
            size = {
                "kind": "cylinder", "center_mm": (x, y, height / 2), "diameter_mm": across, "height_mm": height
            }  # fmt: skip
        solids.append({"name": feature.name, **size})
    measured_names = {name for name, _ in measured_mm}
    return [{**solid, "measured": solid["name"] in measured_names} for solid in solids]


def read_solid_outlines(path: Path) -> list[tuple[str, Lines]]:
    """Return the name and the polylines, (n, 3) mm in the core's frame, of each solid of a features.json.

    Raises
    ------
    InputError
        When the file is not what ``measure features`` writes.
    """
    document = read_json(path)
    is_features = is_mapping(document) and isinstance(document.get("features"), list)
    if not is_features or "pose" not in document:
        raise InputError(f"{path}: is no features.json; give the one of beltscape measure features --out")
    if "solids" not in document:
        raise InputError(
            f"{path}: contains no solids, because an earlier version wrote it; run beltscape measure features again"
        )
    try:
        pose = document["pose"]["core_from_module"]
        core_from_module = Pose.of(pose["rotation"], pose["translation_mm"])
        return [
            (str(solid["name"]), [core_from_module.apply(line) for line in outline_solid(solid)])
            for solid in document["solids"]
        ]
    except (KeyError, TypeError, ValueError) as error:
        kinds = [solid.get("kind") for solid in document["solids"] if is_mapping(solid)]
        odd = next((f"a solid is of kind {kind!r}" for kind in kinds if kind not in DRAWN_KINDS), None)
        reason = odd or "its pose or a solid lacks a key or has another form"
        raise InputError(f"{path}: {reason}; run beltscape measure features again") from error
