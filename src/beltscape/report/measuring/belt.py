"""The report page of the empty belt: its shape, uncertainty and misalignment."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.figure import Figure

from beltscape.core.belt.empty_belt import Belt
from beltscape.report.drawing.charts import Chart, Entry, Key
from beltscape.report.drawing.legend import DIFFERENCE, Scale
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.plots import Form, compute_map_height, make_panels, show_map
from beltscape.report.page import Item, Section, Table, Tile, Tiles, render

_MAP_CELLS = 200
"""Cells of the map on each side, finer than the nodes."""


def render_belt_page(belt: Belt) -> str:
    """Return the page beside a belt.json."""
    items: list[Item] = [_tiles(belt), make_section_chart(belt)]
    sections = [Section("Shape", "x across, z up from where the core's optical axis meets the belt.", items)]
    if belt.deviation is not None:
        sections.append(
            Section(
                "Along the belt",
                "What one cross-section does not tell: sag, waves, or slow errors of the rig.",
                [make_deviation_chart(belt)],
            )
        )
    sections.append(Section("Ends", "Against floor or frame behind them.", [_edge_table(belt)]))
    return render("Empty belt", _summarise(belt), sections, warnings=())


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
    entries = [Entry("height of the belt", "first"), Entry("three σ of it", "band", "area")]
    if belt.flat_mm is not None:
        entries.append(Entry("level middle", "grid", "area"))
    if any(np.isfinite(end) for end in _ends(belt)):
        entries.append(Entry("ends", "limit"))
    return Chart.draw(partial(plot_section, belt), "Cross-section, and three σ of it.", Key(entries))


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
