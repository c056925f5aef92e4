"""The planned rig drawn to scale: from above and from the side, as SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

from beltscape.plan.footprint import Polygon
from beltscape.plan.plan import Plan
from beltscape.report.scene import AUXILIARY, CORE

_BELT, _LOAD, _INK, _ALL = "#ced4da", "#f3d9b1", "#495057", "#2b8a3e"


class _Drawing:
    """Millimetres, second axis upwards → SVG."""

    def __init__(self, low: Sequence[float], high: Sequence[float], width_px: float) -> None:
        margin = 0.03 * max(high[0] - low[0], high[1] - low[1])
        self.left, self.top = low[0] - margin, high[1] + margin
        self.width = width_px
        self.scale = width_px / (high[0] - low[0] + 2 * margin)
        self.height = (high[1] - low[1] + 2 * margin) * self.scale
        self.parts: list[str] = []

    def at(self, point: Sequence[float] | NDArray[np.float64]) -> tuple[float, float]:
        """Where a point in mm lies in the picture."""
        return (float(point[0]) - self.left) * self.scale, (self.top - float(point[1])) * self.scale

    def shape(
        self, points: Sequence[Sequence[float]] | Polygon, *, fill: str = "none", stroke: str = "none",
        width: float = 1.5, opacity: float = 1.0, closed: bool = True, dashed: bool = False,
    ) -> None:  # fmt: skip
        """A polygon or a line."""
        where = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(self.at, points))
        dash = ' stroke-dasharray="7 5"' if dashed else ""
        self.parts.append(
            f'<{"polygon" if closed else "polyline"} points="{where}" fill="{fill}" fill-opacity="{opacity:g}" '
            f'stroke="{stroke}" stroke-width="{width:g}"{dash}/>'
        )

    def dot(self, point: Sequence[float] | NDArray[np.float64], color: str, radius: float = 6) -> None:
        """A disc of fixed size."""
        x, y = self.at(point)
        self.parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}" fill="{color}"/>')

    def text(
        self, point: Sequence[float] | NDArray[np.float64], words: str, *, color: str = _INK,
        shift: tuple[float, float] = (0, 0), anchor: str = "middle",
    ) -> None:  # fmt: skip
        """Words at a place, moved by so many px."""
        x, y = self.at(point)
        self.parts.append(
            f'<text x="{x + shift[0]:.1f}" y="{y + shift[1]:.1f}" fill="{color}" text-anchor="{anchor}" '
            f'stroke="#fff" stroke-width="4" paint-order="stroke">{escape(words)}</text>'
        )

    def measure(self, a: Sequence[float], b: Sequence[float], words: str) -> None:
        """A dimension line with its length."""
        self.shape([a, b], stroke=_INK, width=1, closed=False)
        for end in (a, b):
            self.dot(end, _INK, 2.5)
        upright = abs(a[0] - b[0]) < abs(a[1] - b[1])
        middle = ((a[0] + b[0]) / 2, (a[1] + b[1]) / 2)
        self.text(
            middle, words, shift=(8, 4) if upright else (0, -7), anchor="start" if upright else "middle"
        )

    def svg(self) -> str:
        """The picture."""
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width:.0f} {self.height:.0f}" '
            f'width="{self.width:.0f}" height="{self.height:.0f}" '
            'font-family="system-ui, Liberation Sans, sans-serif" '
            f'font-size="16">{"".join(self.parts)}</svg>'
        )


def top_view(plan: Plan) -> str:
    """Belt, image rectangles at the belt's edges, cameras; x to the right, y upwards."""
    plane, planned = plan.planes[1], plan.planned
    positions = {name: planned.position_mm(name) for name in planned.rig.cameras}
    corners = np.vstack([*plane.polygons.values(), *(p[None, :2] for p in positions.values())])
    low, high = corners.min(axis=0), corners.max(axis=0)
    half = plane.width_mm / 2
    drawing = _Drawing(low, high, 1080)
    drawing.shape(
        [(-half, low[1]), (half, low[1]), (half, high[1]), (-half, high[1])], fill=_BELT, opacity=0.6
    )
    flat = plan.settings.belt.flat_mm / 2
    for x in (-flat, flat):
        drawing.shape([(x, low[1]), (x, high[1])], stroke="#fff", width=2, closed=False)
    drawing.shape(plane.all_cameras, fill=_ALL, opacity=0.25)
    for name, polygon in plane.polygons.items():
        core = name == planned.rig.core
        drawing.shape(polygon, stroke=CORE if core else AUXILIARY, width=3 if core else 1.5)
    length = plan.motion.frame_length_mm / 2
    drawing.shape(
        [(-half, -length), (half, -length), (half, length), (-half, length)],
        stroke=_ALL,
        width=2,
        dashed=True,
    )
    for name, position in positions.items():
        core = name == planned.rig.core
        drawing.shape([position[:2], (0, 0)], stroke=AUXILIARY, width=1, closed=False)
        drawing.dot(position, CORE if core else AUXILIARY)
        drawing.text(position, name, color=CORE if core else AUXILIARY, shift=(0, -12))
    drawing.measure((-half, low[1]), (half, low[1]), f"span {plane.width_mm:.0f} mm")
    drawing.text((-half, high[1]), "belt runs ↕", shift=(10, 20), anchor="start")
    return drawing.svg()


def side_view(plan: Plan, *, along: bool = False) -> str:
    """Cameras, their views and the trough; across the belt, or along it."""
    belt, planned = plan.settings.belt, plan.planned
    axis = 1 if along else 0
    half, flat, edge, top = belt.span_mm / 2, belt.flat_mm / 2, belt.edge_mm, belt.top_mm
    positions = {name: planned.position_mm(name)[[axis, 2]] for name in planned.rig.cameras}
    grounds = np.vstack([p[:, axis] for p in plan.planes[0].polygons.values()])
    reach = max(half, float(np.abs(grounds).max()), *(float(abs(p[0])) for p in positions.values()))
    drawing = _Drawing((-reach, -70), (reach, plan.mounting.above_belt_mm + 110), 720)
    trough = [(-reach, 0), (reach, 0)] if along else [(-half, edge), (-flat, 0), (flat, 0), (half, edge)]
    width = (belt.top_width_mm or belt.span_mm) / 2
    load = (
        [(-reach, 0), (reach, 0), (reach, top), (-reach, top)]
        if along
        else [*trough, (width, top), (-width, top)]
    )
    drawing.shape(load, fill=_LOAD, opacity=0.55)
    for name in [*planned.rig.auxiliaries, planned.rig.core]:
        core = name == planned.rig.core
        ends = plan.planes[0].polygons[name][:, axis]
        color = CORE if core else AUXILIARY
        view = [positions[name], (float(ends.min()), 0.0), (float(ends.max()), 0.0)]
        drawing.shape(view, fill=color, opacity=0.06, stroke=color, width=2.5 if core else 1)
    drawing.shape(trough, stroke="#212529", width=5, closed=False)
    for name, position in positions.items():
        color = CORE if name == planned.rig.core else AUXILIARY
        drawing.dot(position, color, 7)
    for place, names in _together(positions).items():
        color = CORE if planned.rig.core in names else AUXILIARY
        drawing.text((place, plan.mounting.above_belt_mm), ", ".join(names), color=color, shift=(0, -14))
    _dimensions(drawing, plan, along)
    return drawing.svg()


def _together(positions: Mapping[str, NDArray[np.float64]]) -> dict[float, list[str]]:
    """Names of the cameras that are drawn at one place, by its first coordinate."""
    found: dict[float, list[str]] = {}
    for name, position in positions.items():
        found.setdefault(round(float(position[0])) + 0.0, []).append(name)
    return found


def _dimensions(drawing: _Drawing, plan: Plan, along: bool) -> None:
    belt, height = plan.settings.belt, plan.mounting.above_belt_mm
    if along:
        length = plan.motion.frame_length_mm / 2
        top = belt.top_mm
        drawing.measure((-length, top), (length, top), f"full width over {2 * length:.0f} mm")
        return
    drawing.measure((0, 0), (0, height), f"{height:.0f} mm")
    drawing.measure(
        (0, height + 85), (plan.planned.baseline_mm, height + 85), f"{plan.planned.baseline_mm:.0f} mm"
    )
    half = belt.span_mm / 2
    drawing.measure((-half, -60), (half, -60), f"span {belt.span_mm:.0f} mm")
    drawing.text((half, belt.top_mm), f"load up to {belt.top_mm:.0f} mm", shift=(-8, -8), anchor="end")
