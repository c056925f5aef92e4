"""Belt surfaces as triangles, and boxes, spheres and cylinders as lines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Lines = list[NDArray[np.float64]]
_ROUND = 49
"""Points of a circle, of which the last is the first: 7.5° apart."""


def make_belt_triangles(
    document: Mapping[str, Any], along_mm: tuple[float, float]
) -> NDArray[np.float64] | None:
    """Return (T, 3, 3) the belt's cross-section drawn along y, in the belt frame; None where the file has none."""
    belt: Mapping[str, Any] = document.get("belt", document)
    parts: list[Mapping[str, Any]] = [belt, *(value for value in belt.values() if isinstance(value, Mapping))]
    for part in parts:
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


DRAWN_KINDS = ("box", "cylinder", "sphere")
"""Kinds of solids that `outline_solid` draws."""


def outline_solid(solid: Mapping[str, Any]) -> Lines:
    """Return the polylines, (n, 3) in mm, that draw a box, a sphere or a cylinder about its ``center_mm``.

    KeyError, TypeError or ValueError where the mapping describes none of them.
    """
    center = np.array(solid["center_mm"], np.float64).reshape(3)
    if solid["kind"] == "sphere":
        return _sphere(center, float(solid["diameter_mm"]) / 2)
    if solid["kind"] == "cylinder":
        return _cylinder(center, float(solid["diameter_mm"]) / 2, float(solid["height_mm"]))
    if solid["kind"] == "box":
        return _box(center, np.array(solid["size_mm"], np.float64).reshape(3))
    raise ValueError(f"kind {solid['kind']!r}")


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
