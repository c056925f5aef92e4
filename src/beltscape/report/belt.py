"""The learned belt's page: its shape, how sure it is, and how far it runs off."""

from __future__ import annotations

import numpy as np

from beltscape.core.belt_model import Belt
from beltscape.report.page import Figure, Item, Section, Table, Tile, Tiles, render
from beltscape.report.plots import panels, to_png


def belt_page(belt: Belt) -> str:
    """The page beside a belt.json."""
    items: list[Item] = [_tiles(belt), Figure.png(section_plot(belt), "Cross-section, and three σ of it.")]
    sections = [Section("Shape", "x across, z up from where the core's optical axis meets the belt.", items)]
    if belt.deviation is not None:
        sections.append(
            Section(
                "Along the belt",
                "What one cross-section does not tell: sag, waves, or slow errors of the rig.",
                [Figure.png(deviation_plot(belt), "Height over the cross-section, mm.")],
            )
        )
    sections.append(Section("Ends", "Against floor or frame behind them.", [_edge_table(belt)]))
    return render("Empty belt", _verdict(belt), sections, warnings=())


def _verdict(belt: Belt) -> str:
    frames = "one frame" if belt.frames == 1 else f"{belt.frames} frames"
    text = f"Learned from {frames}; points scatter by {belt.noise_mm:.3f} mm about it."
    edges = belt.edges
    if edges is not None and np.isfinite(edges.offset_mm):
        text += f" The belt runs {edges.offset_mm:+.1f} ± {edges.sigma_mm:.1f} mm off the trough's middle."
    return text


def _tiles(belt: Belt) -> Tiles:
    flat = "none" if belt.flat_mm is None else f"{belt.flat_mm[1] - belt.flat_mm[0]:.0f}"
    return Tiles(
        [
            Tile("seen across", f"{belt.across_mm[1] - belt.across_mm[0]:.0f}", "mm", "as far as it is lit"),
            Tile("level middle", flat, "mm" if belt.flat_mm else "", f"x {belt.middle_mm:+.1f} mm"),
            Tile("cross-section", f"{float(np.median(belt.z_sigma_mm)):.4f}", "mm", "one σ of a node"),
            Tile("upright to", f"{np.rad2deg(belt.tilt_sigma_rad):.4f}", "°", "one σ"),
        ]
    )


def section_plot(belt: Belt) -> bytes:
    """The cross-section, with its ends where they were seen."""
    figure, (axis,) = panels(1, columns=1, width=9.5, height=3.2)
    axis.fill_between(
        belt.x_mm, belt.z_mm - 3 * belt.z_sigma_mm, belt.z_mm + 3 * belt.z_sigma_mm, color="#74c0fc"
    )
    axis.plot(belt.x_mm, belt.z_mm, color="#1864ab", linewidth=1.2)
    if belt.flat_mm is not None:
        axis.axvspan(*belt.flat_mm, color="#f1f3f5", zorder=0)
    for end in () if belt.edges is None else (belt.edges.left_mm, belt.edges.right_mm):
        if np.isfinite(end):
            axis.axvline(end, color="#e03131", linewidth=1)
    axis.set(xlabel="x across, mm", ylabel="z, mm")
    axis.set_aspect("equal", adjustable="datalim")
    return to_png(figure)


def deviation_plot(belt: Belt) -> bytes:
    """The deviation as a map."""
    deviation = belt.deviation
    assert deviation is not None
    figure, (axis,) = panels(1, columns=1, width=9.5, height=4.8)
    most = float(np.abs(deviation.height_mm).max())
    image = axis.pcolormesh(
        deviation.x_mm, deviation.y_mm, deviation.height_mm, cmap="RdBu_r", vmin=-most, vmax=most
    )
    axis.set(xlabel="x across, mm", ylabel="y along, mm", aspect="equal")
    figure.colorbar(image, ax=axis, label="mm", shrink=0.85)
    return to_png(figure)


def _edge_table(belt: Belt) -> Table:
    edges = belt.edges
    rows = []
    for name, value, sigma in (
        ()
        if edges is None
        else (
            ("left end, x mm", edges.left_mm, edges.left_sigma_mm),
            ("right end, x mm", edges.right_mm, edges.right_sigma_mm),
            ("middle off the trough's, mm", edges.offset_mm, edges.sigma_mm),
        )
    ):
        seen = np.isfinite(value)
        rows.append([name, f"{value:+.2f}" if seen else "not seen", f"{sigma:.2f}" if seen else "–"])
    return Table(["", "value", "σ"], rows)
