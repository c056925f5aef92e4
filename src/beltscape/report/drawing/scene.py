"""A small 3-D scene of points, lines and labels, as the page's viewer draws it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

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
