"""The true dimensions of a module, listed by the quantities that are measured."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from beltscape.core.geometry.pose import Pose
from beltscape.target.module import Cube, Cylinder, Feature, Module


def describe_module(module: Module, world_from_module: Pose) -> dict[str, Any]:
    """Return the document of `<name>_module.json`.

    ``features`` has an entry ``{"name", "quantity", "true_mm"}`` for each quantity that the measurement of features
    returns; ``places`` holds the height of the top above the level belt's plane z = 0 and the centre of each
    footprint, in the world.
    """
    length, width, _ = module.base.size_mm
    entries = [("base", "length", length), ("base", "width", width)]
    for feature in module.features:
        entries += [(feature.name, quantity, value) for quantity, value in _list_quantities(feature)]
    cubes = sorted(module.cube, key=lambda cube: -cube.edge_mm)
    entries += [
        (f"step:{large.name}-{small.name}", "height_difference", large.edge_mm - small.edge_mm)
        for large, small in pairwise(cubes)
    ]
    return {
        "units": "mm",
        "world_from_module": {
            "rotation": world_from_module.rotation,
            "translation_mm": world_from_module.translation_mm,
        },
        "features": [
            {"name": name, "quantity": quantity, "true_mm": value} for name, quantity, value in entries
        ],
        "places": {feature.name: _locate(feature, world_from_module) for feature in module.features},
    }


def _list_quantities(feature: Feature) -> list[tuple[str, float]]:
    if isinstance(feature, Cube):
        return [("edge", feature.edge_mm), ("height", feature.edge_mm)]
    if isinstance(feature, Cylinder):
        return [("diameter", feature.diameter_mm), ("height", feature.height_mm)]
    return [("radius", feature.diameter_mm / 2)]


def _locate(feature: Feature, world_from_module: Pose) -> dict[str, Any]:
    if isinstance(feature, Cube):
        height = feature.edge_mm
    else:
        height = feature.height_mm if isinstance(feature, Cylinder) else feature.diameter_mm
    foot = world_from_module.translation_mm + world_from_module.rotation[:, :2] @ feature.center_mm
    return {"footprint_mm": foot, "top_mm": foot[2] + height}
