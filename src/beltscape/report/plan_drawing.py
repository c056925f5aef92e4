"""Drawings of the planned rig to scale, from above and from the side, as SVG."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from html import escape

import numpy as np
from numpy.typing import NDArray

from beltscape.plan.coverage import Polygon
from beltscape.plan.plan import Plan
from beltscape.report.drawing.charts import Chart, ChartKey, KeyEntry
from beltscape.report.drawing.palette import css_color, light
from beltscape.report.drawing.plots import FONT_PT, NARROW, WIDE, Form
from beltscape.report.drawing.scene import AUXILIARY, CORE

_HEX = re.compile(r"#[0-9a-f]{6}\b")
_BELT, _LOAD, _INK, _PAPER, _FRAME, _SHARED = (
    light(role) for role in ("belt", "load", "ink", "paper", "common", "shared")
)
_TEXT_ROOM = 22.0
"""Margin of a drawing for a line of text."""
_MAX_HEIGHT = 560.0
"""Maximum height of a drawing, so that it fits a screen."""
_HALF_WIDTH = 390.0
"""Width of a side view; two share a wide screen."""


class Drawing:
    """A drawing in millimetres, second axis upwards, written as SVG in the charts' unit."""

    def __init__(
        self, low: Sequence[float], high: Sequence[float], width: float, *,
        above: float = _TEXT_ROOM, below: float = _TEXT_ROOM,
    ) -> None:  # fmt: skip
        """``width`` and the margins ``above`` and ``below`` the corners are in the charts' unit."""
        tall = (_MAX_HEIGHT - above - below) / (high[1] - low[1])
        self.width = width
        self.px_per_mm = min((width - 2 * _TEXT_ROOM) / (high[0] - low[0]), tall)
        self.left = (low[0] + high[0] - width / self.px_per_mm) / 2
        self.top = high[1] + above / self.px_per_mm
        self.height = (high[1] - low[1]) * self.px_per_mm + above + below
        self.parts: list[str] = []

    def to_picture(self, point: Sequence[float] | NDArray[np.float64]) -> tuple[float, float]:
        """Return the position of a point in mm in the picture."""
        return (float(point[0]) - self.left) * self.px_per_mm, (self.top - float(point[1])) * self.px_per_mm

    def draw_shape(
        self, points: Sequence[Sequence[float] | NDArray[np.float64]] | Polygon, *,
        fill: str = "none", stroke: str = "none", width: float = 1.5, closed: bool = True, dashed: bool = False,
    ) -> None:  # fmt: skip
        """Draw a polygon or a line."""
        coordinates = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(self.to_picture, points))
        dash = ' stroke-dasharray="7 5"' if dashed else ""
        self.parts.append(
            f'<{"polygon" if closed else "polyline"} points="{coordinates}" fill="{fill}" '
            f'stroke="{stroke}" stroke-width="{width:g}"{dash}/>'
        )

    def draw_dot(self, point: Sequence[float] | NDArray[np.float64], color: str, radius: float = 6) -> None:
        """Draw a disc of fixed size."""
        x, y = self.to_picture(point)
        self.parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}" fill="{color}"/>')

    def draw_text(
        self, point: Sequence[float] | NDArray[np.float64], label: str, *, color: str = _INK,
        shift: tuple[float, float] = (0, 0), anchor: str = "middle",
    ) -> None:  # fmt: skip
        """Draw text at a point, shifted by ``shift`` px."""
        x, y = self.to_picture(point)
        self.parts.append(
            f'<text x="{x + shift[0]:.1f}" y="{y + shift[1]:.1f}" fill="{color}" text-anchor="{anchor}" '
            f'stroke="{_PAPER}" stroke-width="4" paint-order="stroke">{escape(label)}</text>'
        )

    def draw_dimension(self, a: Sequence[float], b: Sequence[float], label: str, *, up: float = 0.0) -> None:
        """Draw a dimension line with its length, ``up`` px above its place."""
        a, b = ((end[0], end[1] + up / self.px_per_mm) for end in (a, b))
        self.draw_shape([a, b], stroke=_INK, width=1, closed=False)
        for end in (a, b):
            self.draw_dot(end, _INK, 2.5)
        is_vertical = abs(a[0] - b[0]) < abs(a[1] - b[1])
        middle = ((a[0] + b[0]) / 2, (a[1] + b[1]) / 2)
        self.draw_text(
            middle,
            label,
            shift=(8, 4) if is_vertical else (0, -7),
            anchor="start" if is_vertical else "middle",
        )

    def to_svg(self) -> str:
        """Return the picture."""
        return (
            f'<svg viewBox="0 0 {self.width:.0f} {self.height:.0f}" data-px-per-mm="{self.px_per_mm:.5f}" '
            f'font-size="{FONT_PT:g}">{re.sub(_HEX, lambda match: css_color(match[0]), "".join(self.parts))}</svg>'
        )


def make_side_charts(plan: Plan) -> tuple[Chart, Chart]:
    """Return the views across and along the belt, both on the same scale."""
    key = (KeyEntry("core's view", "core", "outline"), KeyEntry("auxiliaries' views", "auxiliary", "outline"))
    load = KeyEntry("load", "load", "area")
    across = _make_chart(partial(draw_side_view, plan), "Across the belt.", *key, load)
    caption = "Along the belt, on the same scale."
    return across, _make_chart(partial(draw_side_view, plan, along=True), caption, *key, load)


def make_top_chart(plan: Plan) -> Chart:
    """Return the view from above."""
    return _make_chart(
        partial(draw_top_view, plan),
        "From above; images' rims at the height of the belt's edges.",
        KeyEntry("core's image", "core", "outline"), KeyEntry("auxiliaries' images", "auxiliary", "outline"),
        KeyEntry("seen by all cameras", "shared", "area"),
        KeyEntry("what a frame gives over the full width at every height", "common", "dashed"),
        half=False,
    )  # fmt: skip


def _make_chart(view: Callable[[Form], str], caption: str, *entries: KeyEntry, half: bool = True) -> Chart:
    return Chart(view(WIDE), view(NARROW), caption, [ChartKey(entries)], half)


def draw_top_view(plan: Plan, form: Form) -> str:
    """Draw belt, image borders at the height of the belt's edges, and cameras; x to the right, y upwards."""
    plane, planned = plan.planes[1], plan.planned
    positions = {name: planned.position_mm(name) for name in planned.rig.cameras}
    corners = np.vstack([*plane.polygons.values(), *(p[None, :2] for p in positions.values())])
    low, high = corners.min(axis=0), corners.max(axis=0)
    drawing = Drawing(low, high, form.width)
    _draw_belt(drawing, plan, float(low[1]), float(high[1]))
    for name, polygon in plane.polygons.items():
        core = name == planned.rig.core
        drawing.draw_shape(polygon, stroke=CORE if core else AUXILIARY, width=2.5 if core else 1.2)
    half, length = plane.width_mm / 2, plan.motion.frame_length_mm / 2
    frame = [(-half, -length), (half, -length), (half, length), (-half, length)]
    drawing.draw_shape(frame, stroke=_FRAME, width=2, dashed=True)
    for name, position in positions.items():
        core = name == planned.rig.core
        color = CORE if core else AUXILIARY
        drawing.draw_shape([position[:2], (0, 0)], stroke=AUXILIARY, width=1, closed=False)
        drawing.draw_dot(position, color, 5)
        drawing.draw_text(position, name, color=color, shift=(0, -9))
    drawing.draw_dimension((-half, low[1]), (half, low[1]), f"span {plane.width_mm:.0f} mm")
    drawing.draw_text((-half, high[1]), "belt runs ↕", shift=(6, 14), anchor="start")
    return drawing.to_svg()


def _draw_belt(drawing: Drawing, plan: Plan, low: float, high: float) -> None:
    """Draw the belt from above, the area seen by all cameras, and the ends of the level middle."""
    half, flat = plan.planes[1].width_mm / 2, plan.settings.belt.flat_mm / 2
    drawing.draw_shape([(-half, low), (half, low), (half, high), (-half, high)], fill=_BELT)
    drawing.draw_shape(plan.planes[1].all_cameras, fill=_SHARED)
    for x in (-flat, flat):
        drawing.draw_shape([(x, low), (x, high)], stroke=_PAPER, width=2, closed=False)


def draw_side_view(plan: Plan, form: Form, *, along: bool = False) -> str:
    """Draw cameras, their views and the trough, across the belt or along it, on one scale."""
    belt, planned = plan.settings.belt, plan.planned
    half, flat, edge, top = belt.span_mm / 2, belt.flat_mm / 2, belt.edge_mm, belt.top_mm
    positions = {name: planned.position_mm(name)[[int(along), 2]] for name in planned.rig.cameras}
    reach = _side_reach_mm(plan)
    width = form.width if form.narrow else _HALF_WIDTH
    highest = plan.mounting.above_belt_mm
    drawing = Drawing((-reach, 0), (reach, highest), width, above=62, below=38)
    trough = [(-reach, 0), (reach, 0)] if along else [(-half, edge), (-flat, 0), (flat, 0), (half, edge)]
    heap = (belt.top_width_mm or belt.span_mm) / 2
    load = [*trough, (reach, top), (-reach, top)] if along else [*trough, (heap, top), (-heap, top)]
    drawing.draw_shape(load, fill=_LOAD)
    for name in [*planned.rig.auxiliaries, planned.rig.core]:
        core = name == planned.rig.core
        ends = plan.planes[0].polygons[name][:, int(along)]
        view = [positions[name], (float(ends.min()), 0.0), (float(ends.max()), 0.0)]
        drawing.draw_shape(view, stroke=CORE if core else AUXILIARY, width=2 if core else 1.2)
    drawing.draw_shape(trough, stroke=_INK, width=3.5, closed=False)
    for name in [*planned.rig.auxiliaries, planned.rig.core]:
        drawing.draw_dot(positions[name], CORE if name == planned.rig.core else AUXILIARY, 5)
    for position, names in _group_cameras(positions).items():
        core = planned.rig.core in names  # its row is above the others', which it would overlap on a phone
        color, lift = (CORE, -26) if core else (AUXILIARY, -10)
        drawing.draw_text((position, highest), ", ".join(names), color=color, shift=(0, lift))
    _draw_dimensions(drawing, plan, along)
    return drawing.to_svg()


def _side_reach_mm(plan: Plan) -> float:
    """Return half the length that both side views show, so that they have one scale."""
    footprints = np.abs(np.vstack(list(plan.planes[0].polygons.values())))
    lenses = [np.abs(plan.planned.position_mm(name)[:2]).max() for name in plan.planned.rig.cameras]
    return max(plan.settings.belt.span_mm / 2, float(footprints.max()), *map(float, lenses))


def _group_cameras(positions: Mapping[str, NDArray[np.float64]]) -> dict[float, list[str]]:
    """Return the names of cameras drawn at one position, by its first coordinate."""
    groups: dict[float, list[str]] = {}
    for name, position in positions.items():
        groups.setdefault(round(float(position[0])) + 0.0, []).append(name)
    return groups


def _draw_dimensions(drawing: Drawing, plan: Plan, along: bool) -> None:
    belt, height = plan.settings.belt, plan.mounting.above_belt_mm
    if along:
        length = plan.motion.frame_length_mm / 2
        top = belt.top_mm
        drawing.draw_dimension((-length, top), (length, top), f"full width over {2 * length:.0f} mm")
        return
    drawing.draw_dimension((0, 0), (0, height), f"{height:.0f} mm")
    baseline = plan.planned.baseline_mm
    drawing.draw_dimension((0, height), (baseline, height), f"{baseline:.0f} mm", up=44)
    half = belt.span_mm / 2
    drawing.draw_dimension((-half, 0), (half, 0), f"span {belt.span_mm:.0f} mm", up=-28)
    drawing.draw_text((half, belt.top_mm), f"load up to {belt.top_mm:.0f} mm", shift=(-8, -8), anchor="end")
