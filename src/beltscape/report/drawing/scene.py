"""A small 3-D scene of points, lines and labels, as the page's viewer draws it.

Belt surfaces are triangles; boxes, spheres and cylinders are lines.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.rig import Rig
from beltscape.report.drawing.palette import css_color, light

CORE, AUXILIARY, QUIET = light("core"), light("auxiliary"), light("board")


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """The lines, labels and points of a drawing, in mm and the core camera's axes (x right, y down, z forward)."""

    lines: tuple[tuple[str, NDArray[np.float64]], ...] = ()
    """(colour, (n, 3) polyline)."""
    labels: tuple[tuple[str, NDArray[np.float64]], ...] = ()
    """(text, (3,) where)."""
    points_mm: NDArray[np.float64] | None = None
    """(N, 3)."""
    colors: NDArray[np.uint8] | None = None
    """(N, 3) RGB of the points."""

    def to_json(self) -> str:
        """Return the scene as JSON for the viewer; coordinates rounded to 0.1 mm keep the page small."""
        points = np.empty((0, 3)) if self.points_mm is None else self.points_mm
        colors = np.empty((0, 3), np.uint8) if self.colors is None else self.colors
        return json.dumps(
            {
                "lines": [[css_color(color), np.round(line, 1).tolist()] for color, line in self.lines],
                "labels": [[text, np.round(where, 1).tolist()] for text, where in self.labels],
                "points": np.round(points, 1).tolist(),
                "colors": colors.tolist(),
            },
            separators=(",", ":"),
            allow_nan=False,
        )


def make_rig_scene(
    rig: Rig, *, length_mm: float, boards_mm: Mapping[str, NDArray[np.float64]] | None = None
) -> Scene:
    """Return the cameras' frusta, drawn ``length_mm`` long, and the outlines (n, 3) of boards in the core frame."""
    lines: list[tuple[str, NDArray[np.float64]]] = [
        (QUIET, outline) for outline in (boards_mm or {}).values()
    ]
    labels: list[tuple[str, NDArray[np.float64]]] = []
    for name, camera in rig.cameras.items():
        core_from_cam = rig.cam_from_core[name].inverse()
        width, height = camera.size_px
        pixels = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]])
        ideal, pinhole = camera.undistort(pixels), (pixels - camera.center_px) / camera.focal_px
        ideal = np.where(np.isfinite(ideal), ideal, pinhole)  # a lens model may not reach its image's corners
        ends = core_from_cam.apply(np.column_stack([ideal, np.ones(4)]) * length_mm)
        center = core_from_cam.translation_mm
        color = CORE if name == rig.core else AUXILIARY
        lines.append((color, np.concatenate([ends, ends[:1]])))
        lines.extend((color, np.stack([center, end])) for end in ends)
        labels.append((name, center))
    return Scene(tuple(lines), tuple(labels))


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
