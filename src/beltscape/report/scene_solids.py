"""Belt surfaces and fitted primitives as triangles and lines, read tolerantly from the measuring commands' files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.pose import Pose

Lines = list[NDArray[np.float64]]
_ROUND = 49


def belt_triangles(document: Mapping[str, Any], along_mm: tuple[float, float]) -> NDArray[np.float64] | None:
    """(T, 3, 3) the belt's cross-section drawn along y, in the belt frame; None where the file tells none."""
    belt = document.get("belt", document)
    for part in (belt, *(value for value in belt.values() if isinstance(value, Mapping))):
        if "x_mm" in part and "z_mm" in part:
            x, z = (np.array(part[name], np.float64) for name in ("x_mm", "z_mm"))
            break
    else:
        return None
    near, far = along_mm
    one = np.column_stack([x, np.full(len(x), near), z])
    two = np.column_stack([x, np.full(len(x), far), z])
    first = np.stack([one[:-1], one[1:], two[1:]], axis=1)
    second = np.stack([one[:-1], two[1:], two[:-1]], axis=1)
    triangles = np.concatenate([first, second])
    return triangles[np.isfinite(triangles).all(axis=(1, 2))]


def outlines_of(document: Mapping[str, Any]) -> Iterator[tuple[str, Lines]]:
    """(name, polylines (n, 3) in the core frame) of the features of a features.json; what it does not know it skips.

    A feature is a mapping with its dimensions (``edge_mm``, ``size_mm``, ``diameter_mm``, ``height_mm``; numbers,
    or mappings with a ``value``) and ``center_mm``: of its footprint with two numbers, of its middle with three.
    Where the file has ``core_from_module`` places are in the module's frame, else in the core's.
    """
    pose = _pose(document.get("core_from_module"))
    features = document.get("features", [])
    named = features.items() if isinstance(features, Mapping) else ((None, each) for each in features)
    for key, feature in named:
        if not isinstance(feature, Mapping):
            continue
        lines = _outline(feature)
        if lines:
            name = str(feature.get("name", key or ""))
            yield name, lines if pose is None else [pose.apply(line) for line in lines]


def _outline(feature: Mapping[str, Any]) -> Lines:
    kind = str(feature.get("kind", feature.get("shape", feature.get("type", "")))).lower()
    center = _numbers(feature, "center_mm", "centre_mm")
    if center is None or len(center) not in (2, 3):
        return []
    diameter, height = _number(feature, "diameter_mm"), _number(feature, "height_mm")
    if kind == "sphere" and diameter is not None:
        middle = center if len(center) == 3 else np.append(center, diameter / 2)
        return _sphere(middle, diameter / 2)
    if kind == "cylinder" and diameter is not None and height is not None:
        return _cylinder(center if len(center) == 3 else np.append(center, height / 2), diameter / 2, height)
    size = _numbers(feature, "size_mm")
    edge = _number(feature, "edge_mm")
    if edge is not None:
        size = np.array([edge, edge, height or edge])
    if size is None or len(size) != 3:
        return []
    middle = center if len(center) == 3 else np.append(center, size[2] / 2)
    return _box(middle, size)


def _box(middle: NDArray[np.float64], size: NDArray[np.float64]) -> Lines:
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) / 2
    rings = [middle + np.column_stack([square, np.full(5, end)]) * size for end in (-0.5, 0.5)]
    return [*rings, *(np.stack([rings[0][i], rings[1][i]]) for i in range(4))]


def _sphere(middle: NDArray[np.float64], radius: float) -> Lines:
    turn = np.linspace(0, 2 * np.pi, _ROUND)
    cosine, sine, none = radius * np.cos(turn), radius * np.sin(turn), np.zeros(_ROUND)
    circles = ([cosine, sine, none], [cosine, none, sine], [none, cosine, sine])
    return [middle + np.column_stack(circle) for circle in circles]


def _cylinder(middle: NDArray[np.float64], radius: float, height: float) -> Lines:
    turn = np.linspace(0, 2 * np.pi, _ROUND)
    ring = radius * np.column_stack([np.cos(turn), np.sin(turn)])
    ends = [middle + np.column_stack([ring, np.full(_ROUND, end * height)]) for end in (-0.5, 0.5)]
    return [*ends, *(np.stack([ends[0][i], ends[1][i]]) for i in range(0, _ROUND - 1, 12))]


def _pose(value: object) -> Pose | None:
    if not isinstance(value, Mapping) or not {"rotation", "translation_mm"} <= set(value):
        return None
    return Pose(np.array(value["rotation"], np.float64), np.array(value["translation_mm"], np.float64))


def _number(feature: Mapping[str, Any], name: str) -> float | None:
    value = feature.get(name)
    if isinstance(value, Mapping):
        value = value.get("value", value.get("value_mm"))
    return float(value) if isinstance(value, int | float) else None


def _numbers(feature: Mapping[str, Any], *names: str) -> NDArray[np.float64] | None:
    for name in names:
        value = feature.get(name)
        if isinstance(value, Mapping):
            value = value.get("value")
        if isinstance(value, list) and all(isinstance(part, int | float) for part in value):
            return np.array(value, np.float64)
    return None
