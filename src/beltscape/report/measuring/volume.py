"""The report page of a volume: the load's height map, uncertainty and cross-sections."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from beltscape.measure.volume.volume import Volume
from beltscape.report.drawing.charts import Chart, ChartKey, KeyEntry
from beltscape.report.drawing.legend import HEIGHT, Scale
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.pictures import quantile_range
from beltscape.report.drawing.plots import Form, compute_map_height, fade_unmeasured, make_panels, show_map
from beltscape.report.page import Item, Section, Table, Tile, Tiles, render


def render_volume_page(volume: Volume, *, warnings: Sequence[str]) -> str:
    """Return report.html of a volume."""
    sections = [
        Section("The load", "Heights above the empty belt, in the belt frame.", make_volume_items(volume)),
        Section(
            "How sure, and where its weight acts",
            "Of an evenly dense load; x across, y along the belt, z up from the belt's level middle.",
            [make_sigma_table(volume), make_centre_table(volume)],
        ),
        Section(
            "Cross-sections",
            "Each is the mean over its stretch of belt; area times length adds up to the volume.",
            [make_profiles_chart(volume), _profile_table(volume)],
        ),
    ]
    return render("Volume on the belt", summarise_volume(volume), sections, warnings=warnings)


def format_litres(volume_mm3: float) -> str:
    """Return a volume in litres with three decimals."""
    return f"{volume_mm3 * 1e-6:.3f}"


def summarise_volume(volume: Volume) -> str:
    """Return the result in a sentence."""
    return (
        f"{format_litres(volume.volume_mm3)} ± {format_litres(volume.sigma_mm3)} litres between "
        f"x = {volume.across_mm[0]:.0f} … "
        f"{volume.across_mm[1]:.0f} mm and y = {volume.along_mm[0]:.0f} … {volume.along_mm[1]:.0f} mm; "
        f"{volume.coverage:.1%} of that belt was measured, the rest is interpolated."
    )


def make_volume_items(volume: Volume) -> list[Item]:
    """Return the key figures and the height map."""
    length = volume.along_mm[1] - volume.along_mm[0]
    return [
        Tiles(
            [
                Tile(
                    "volume", format_litres(volume.volume_mm3), "l", f"σ {format_litres(volume.sigma_mm3)} l"
                ),
                Tile(
                    "mean cross-section",
                    f"{volume.volume_mm3 / length / 100:.1f}",
                    "cm²",
                    f"over {length:.0f} mm",
                ),
                Tile("measured", f"{100 * volume.coverage:.1f}", "%", "the rest is interpolated"),
                *_load_tiles(volume),
            ]
        ),
        make_height_chart(volume),
    ]


def _load_tiles(volume: Volume) -> list[Tile]:
    """Return the tiles of fill level, highest point and eccentricity of the load."""
    full, summit, centre = volume.fullness, volume.summit, volume.centre
    of = "of the whole belt" if full.whole_belt else "of the part of the belt that was seen"
    level = f"{100 * full.level:.0f}" if np.isfinite(full.level) else "unknown"
    unit = "%" if np.isfinite(full.level) else ""
    tiles = [Tile("full", level, unit, f"{full.capacity_mm2 / 100:.0f} cm² {of}")]
    if summit is not None:
        where = f"at x {summit.position_mm[0]:.0f}, y {summit.position_mm[1]:.0f} mm"
        tiles.append(Tile("highest", f"{summit.height_mm:.1f}", "mm", where))
    if centre is not None:
        sigma = f"σ {centre.off_middle_sigma_mm:.1f} mm"
        tiles.append(Tile("load off the middle", f"{centre.off_middle_mm:+.1f}", "mm", sigma))
    return tiles


def make_sigma_table(volume: Volume) -> Table:
    """Return the table of the uncertainty's components."""
    causes = volume.causes
    rows = (
        ("places that no camera measured", causes.holes_mm3),
        ("where steps lie", causes.edges_mm3),
        ("noise of the depth map", causes.noise_mm3),
        ("the empty belt", causes.belt_mm3),
        ("slow errors of the depth map", causes.drift_mm3),
        ("depths that may be false", causes.false_depths_mm3),
        ("size of the calibration board", causes.scale_mm3),
        ("what nothing bounds, in the box or beside it", causes.unseen_mm3),
        ("together (root of the sum of squares)", volume.sigma_mm3),
    )
    return Table(["cause", "σ, litres"], [[name, f"{value * 1e-6:.4f}"] for name, value in rows])


def make_centre_table(volume: Volume) -> Table:
    """Return the table of the centre of gravity."""
    centre = volume.centre
    if centre is None:
        return Table(["centre of gravity", "mm", "σ"], [["none: hardly any load", "–", "–"]])
    rows = [
        [name, f"{value:.1f}", f"{sigma:.1f}"]
        for name, value, sigma in zip("xyz", centre.position_mm, centre.sigma_mm, strict=True)
    ]
    off = [f"{centre.off_middle_mm:+.1f}", f"{centre.off_middle_sigma_mm:.1f}"]
    return Table(["centre of gravity", "mm", "σ"], [*rows, ["off the belt's middle", *off]])


def make_height_chart(volume: Volume) -> Chart:
    """Return the load's height map as a chart."""
    low, high = quantile_range(volume.load.height_mm, 0.002)
    scale = Scale(min(low, 0.0), high, HEIGHT, label="height, mm")
    signs = [KeyEntry("stretch that is measured", "limit", "outline")]
    if volume.centre is not None:
        signs.append(KeyEntry("centre of gravity", "limit", "cross"))
    caption = "Height of the load above the empty belt; interpolated cells are faded, unknown ones empty."
    return Chart.draw(partial(plot_heights, volume, scale), caption, scale, ChartKey(signs))


def plot_heights(volume: Volume, scale: Scale, form: Form) -> Figure:
    """Plot the load's height map with the box and what was interpolated."""
    load = volume.load
    half = load.cell_mm / 2
    extent = (load.x_mm[0] - half, load.x_mm[-1] + half, load.y_mm[0] - half, load.y_mm[-1] + half)
    height = compute_map_height(form, extent[1] - extent[0], extent[3] - extent[2])
    figure, (axis,) = make_panels(1, form, height=height)
    show_map(
        axis, fade_unmeasured(scale.to_rgb(load.height_mm), load.height_mm, ~volume.interpolated), extent
    )
    (x0, x1), (y0, y1) = volume.across_mm, volume.along_mm
    box = Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, edgecolor=light("limit"), linewidth=1.8)
    axis.add_patch(box)
    if volume.centre is not None:
        axis.plot(
            *volume.centre.position_mm[:2], "x", color=light("limit"), markersize=11, markeredgewidth=2.5
        )
    axis.set(xlabel="x across, mm", ylabel="y along, mm", xlim=extent[:2], ylim=extent[2:])
    return figure


def make_profiles_chart(volume: Volume) -> Chart:
    """Return all cross-sections as a chart."""
    scale = Scale(volume.along_mm[0], volume.along_mm[1], HEIGHT[85:205], label="y along the belt, mm")
    caption = "Cross-sections of the load above the empty belt."
    return Chart.draw(partial(plot_profiles, volume, scale), caption, scale)


def plot_profiles(volume: Volume, scale: Scale, form: Form) -> Figure:
    """Plot all cross-sections over one another, coloured along the belt."""
    figure, (axis,) = make_panels(1, form, height=270, narrow_height=200)
    for profile in volume.profiles:
        color = tuple(scale.to_rgb(np.array(profile.y_mm)) / 255.0)
        axis.plot(profile.x_mm, profile.height_mm, color=color, linewidth=1.4)
    axis.set(xlabel="x across, mm", ylabel="height, mm")
    axis.grid()
    return figure


def _profile_table(volume: Volume) -> Table:
    return Table(
        ["y mm", "area cm²", "measured"],
        [[f"{p.y_mm:.1f}", f"{p.area_mm2 / 100:.2f}", f"{p.coverage:.1%}"] for p in volume.profiles],
    )
