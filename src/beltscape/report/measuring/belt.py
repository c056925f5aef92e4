"""The report page of the empty belt: its shape, uncertainty and misalignment."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import cv2
import numpy as np
from matplotlib.figure import Figure

from beltscape.core.depth import DepthMap
from beltscape.core.empty_belt import Belt
from beltscape.core.geometry.camera import Camera
from beltscape.report.drawing.charts import Chart, ChartKey, KeyEntry
from beltscape.report.drawing.legend import DIFFERENCE, Color, Rgb, Scale, Swatches
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.pictures import Panel, quantile_range
from beltscape.report.drawing.plots import Form, compute_map_height, make_panels, show_map
from beltscape.report.page import Item, Pictures, Section, Table, Tile, Tiles, render

ON_BELT_MM = 12.0
"""Points further off the learned belt are drawn as something else; see `measure.belt.extent`."""
_ON: Color = (64, 150, 235)
"""Colour of the belt in the picture."""
_SEEN, _STATED = (0, 200, 120), (240, 130, 0)
"""Colours of ends that were seen, and of those that were not."""
_MAP_CELLS = 200
"""Cells of the map on each side, finer than the nodes."""


def render_belt_page(belt: Belt, depth: DepthMap | None = None, warnings: Sequence[str] = ()) -> str:
    """Return the page beside a belt.json; ``depth`` is the depth map that it was learned from, for a picture."""
    items: list[Item] = [_tiles(belt)]
    if depth is not None and belt.camera is not None:
        items.append(Pictures([make_belt_panel(belt, depth, belt.camera)]))
    items.append(make_section_chart(belt))
    sections = [Section("Shape", "x across, z up from where the core's optical axis meets the belt.", items)]
    if belt.deviation is not None:
        sections.append(
            Section(
                "Along the belt",
                "What one cross-section does not tell: sag, waves, or slow errors of the rig.",
                [make_deviation_chart(belt)],
            )
        )
    sections.append(Section("Ends", _describe_ends(belt), [_edge_table(belt)]))
    return render("Empty belt", _summarise(belt), sections, warnings=warnings)


def make_belt_panel(belt: Belt, depth: DepthMap, camera: Camera) -> Panel:
    """Return the core camera's view: what was taken as belt, what else was measured, and the ends as lines."""
    points = belt.belt_from_core.apply(depth.points_mm(camera))
    x, y = points[..., 0], points[..., 1]
    off = points[..., 2] - belt.height_at_mm(x, y)
    on = np.abs(off) <= ON_BELT_MM  # NaN is not
    on &= (x >= belt.across_mm[0]) & (x <= belt.across_mm[1])
    near, far = quantile_range(depth.depth_mm)
    grey = np.rint(np.clip(1 - (depth.depth_mm - near) / (far - near), 0, 1) * 150 + 70)
    image = np.repeat(np.where(np.isfinite(grey), grey, 25.0)[..., None], 3, axis=2)
    image[on] = 0.5 * image[on] + 0.5 * np.array(_ON)
    drawn = np.ascontiguousarray(image, np.uint8)
    for place, end in zip(_end_places(belt), belt.ends or ("seen", "seen"), strict=True):
        _draw_end(drawn, belt, camera, place, _SEEN if end == "seen" else _STATED)
    legend = Swatches(
        [("belt", _ON), ("something else", (150, 150, 150)), ("not measured", (25, 25, 25)),
         ("end that was seen", _SEEN), ("end given, inferred or unknown", _STATED)]
    )  # fmt: skip
    return Panel(drawn, "What was taken as belt, in the core camera's undistorted image", legend)


def _draw_end(image: Rgb, belt: Belt, camera: Camera, place_mm: float, color: Color) -> None:
    """Draw the line along the belt at x = ``place_mm``."""
    y = np.linspace(*belt.along_mm, 40)
    x = np.full(len(y), place_mm)
    points = belt.belt_from_core.inverse().apply(np.stack([x, y, belt.height_at_mm(x, y)], axis=-1))
    pixels = points[:, :2] / points[:, 2:] * camera.focal_px + camera.center_px
    width = max(2, image.shape[1] // 300)
    cv2.polylines(image, [np.rint(pixels).astype(np.int32)], False, color, width, cv2.LINE_AA)


def _end_places(belt: Belt) -> tuple[float, float]:
    """Return the ends in x: located against what is beside the belt, else where the measured belt ends."""
    left, right = (
        own if np.isfinite(own) else measured
        for own, measured in zip(_ends(belt) or (np.nan,) * 2, belt.across_mm, strict=True)
    )
    return left, right


def _describe_ends(belt: Belt) -> str:
    """Return what is known of the ends in a sentence."""
    if belt.ends is None:
        return "Against floor or frame behind them."
    left, right = belt.ends
    width = "" if belt.width_mm is None else f"; the width along the surface is given as {belt.width_mm:g} mm"
    return f"The left end, at the smaller x: {left}. The right end: {right}{width}."


def _summarise(belt: Belt) -> str:
    frames = "one frame" if belt.frames == 1 else f"{belt.frames} frames"
    text = f"Learned from {frames}; points scatter by {belt.noise_mm:.3f} mm about it."
    edges = belt.edges
    if edges is not None and np.isfinite(edges.offset_mm):
        text += f" The belt runs {edges.offset_mm:+.1f} ± {edges.sigma_mm:.1f} mm off the trough's middle."
    return text


def _tiles(belt: Belt) -> Tiles:
    flat = "none" if belt.flat_mm is None else f"{belt.flat_mm[1] - belt.flat_mm[0]:.0f}"
    z_sigma, tilt_sigma = float(np.median(belt.z_sigma_mm)), np.rad2deg(belt.tilt_sigma_rad)
    return Tiles(
        [
            Tile("seen across", f"{belt.across_mm[1] - belt.across_mm[0]:.0f}", "mm", "as far as it is lit"),
            Tile("level middle", flat, "mm" if belt.flat_mm else "", f"x {belt.middle_mm:+.1f} mm"),
            Tile("σ of the cross-section", f"{z_sigma:.4f}", "mm", "of its height, median over its nodes"),
            Tile("σ of the tilt", f"{tilt_sigma:.4f}", "°", "against the vertical"),
        ]
    )


def make_section_chart(belt: Belt) -> Chart:
    """Return the cross-section as a chart."""
    entries = [KeyEntry("height of the belt", "first"), KeyEntry("three σ of it", "band", "area")]
    if belt.flat_mm is not None:
        entries.append(KeyEntry("level middle", "grid", "area"))
    if any(np.isfinite(end) for end in _ends(belt)):
        entries.append(KeyEntry("ends", "limit"))
    return Chart.draw(partial(plot_section, belt), "Cross-section, and three σ of it.", ChartKey(entries))


def plot_section(belt: Belt, form: Form) -> Figure:
    """Plot the cross-section, with its ends if they were measured."""
    figure, (axis,) = make_panels(1, form, height=230, narrow_height=170)
    low, high = belt.z_mm - 3 * belt.z_sigma_mm, belt.z_mm + 3 * belt.z_sigma_mm
    axis.fill_between(belt.x_mm, low, high, color=light("band"), linewidth=0)
    axis.plot(belt.x_mm, belt.z_mm, color=light("first"), linewidth=1.4)
    if belt.flat_mm is not None:
        axis.axvspan(*belt.flat_mm, color=light("grid"), zorder=0, linewidth=0)
    for end in _ends(belt):
        if np.isfinite(end):
            axis.axvline(end, color=light("limit"), linewidth=1.2)
    axis.set(xlabel="x across, mm", ylabel="z, mm")
    axis.set_aspect("equal", adjustable="datalim")
    return figure


def make_deviation_chart(belt: Belt) -> Chart:
    """Return the deviation along the belt as a chart."""
    deviation = belt.deviation
    assert deviation is not None
    most = max(float(np.abs(deviation.height_mm).max()), 1e-6)
    label = "height over the cross-section, mm; blue: below, red: above"
    scale = Scale(-most, most, DIFFERENCE, label=label)
    return Chart.draw(partial(plot_deviation, belt, scale), "Height over the cross-section.", scale)


def plot_deviation(belt: Belt, scale: Scale, form: Form) -> Figure:
    """Plot the deviation as a map."""
    deviation = belt.deviation
    assert deviation is not None
    left, right = float(deviation.x_mm[0]), float(deviation.x_mm[-1])
    low, high = float(deviation.y_mm[0]), float(deviation.y_mm[-1])
    x, y = np.linspace(left, right, _MAP_CELLS), np.linspace(low, high, _MAP_CELLS)
    figure, (axis,) = make_panels(1, form, height=compute_map_height(form, np.ptp(x), np.ptp(y)))
    show_map(axis, scale.to_rgb(deviation.interpolate(x[None], y[:, None])), (left, right, low, high))
    axis.set(xlabel="x across, mm", ylabel="y along, mm")
    return figure


def _ends(belt: Belt) -> tuple[float, ...]:
    return () if belt.edges is None else (belt.edges.left_mm, belt.edges.right_mm)


def _edge_table(belt: Belt) -> Table:
    edges = belt.edges
    rows: list[list[str]] = []
    for name, value, sigma in (
        ()
        if edges is None
        else (
            ("left end, x mm", edges.left_mm, edges.left_sigma_mm),
            ("right end, x mm", edges.right_mm, edges.right_sigma_mm),
            ("middle off the trough's, mm", edges.offset_mm, edges.sigma_mm),
        )
    ):
        is_known = np.isfinite(value)
        rows.append([name, f"{value:+.2f}" if is_known else "not seen", f"{sigma:.2f}" if is_known else "–"])
    return Table(["", "value", "σ"], rows)
