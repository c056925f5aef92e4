"""The report page of the lumps: sizes, size distribution and oversize."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.frames import Image
from beltscape.measure.lumps.lumps import BIAS, Lumps
from beltscape.measure.lumps.shape import Lump
from beltscape.report.drawing.charts import Chart, Entry, Key, Mark
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.plots import Form, make_panels
from beltscape.report.measuring.lumps_pictures import largest_lumps, make_lump_panels
from beltscape.report.page import Item, Lines, Pictures, Section, Table, Tile, Tiles, render

_CURVES: tuple[tuple[str, bool, str, Mark], ...] = (
    ("all lumps", False, "first", "line"), ("fully visible", True, "second", "dashed"),
)  # fmt: skip
"""(name, whether of fully visible lumps only, role of the palette, mark)."""


def render_lumps_page(lumps: Lumps, depth: DepthMap, picture: Image | None) -> str:
    """Return report.html of a frame's lumps."""
    sections = [
        Section("Lumps in view", "Each lump in the colour of its size.", _view(lumps, depth, picture)),
        Section("Size distribution", BIAS, _sizes(lumps)),
        Section("The largest", "Sizes with one standard deviation.", [_table(lumps)]),
    ]
    return render("Lumps on the belt", summarise_lumps(lumps), sections)


def summarise_lumps(lumps: Lumps) -> str:
    """Return the result in a sentence or two."""
    if not lumps.lumps:
        return "No lumps in view."
    whole = sum(not lump.occluded and not lump.cut for lump in lumps.lumps)
    text = f"{len(lumps.lumps)} lumps in view, {whole} of them fully visible"
    if lumps.all.count:
        text += (
            f"; half of the mass is in lumps below {lumps.all.d_mm[1]:.0f} ± {lumps.all.d_sigma_mm[1]:.0f} mm"
        )
    alarm = lumps.oversize
    if alarm is None:
        return text + "."
    over = sum(chance > 0.5 for _, chance in alarm.lumps)
    if alarm.alarm:
        return f"{text}. Oversize: {over} over {alarm.limit_mm:g} mm."
    return f"{text}. None over {alarm.limit_mm:g} mm (probability of one {alarm.probability:.0%})."


def _view(lumps: Lumps, depth: DepthMap, picture: Image | None) -> list[Item]:
    tiles = [
        Tile(name, f"{d:.1f}" if np.isfinite(d) else "–", "mm", f"σ {s:.1f} mm")
        for name, d, s in zip(("d10", "d50", "d80"), lumps.all.d_mm, lumps.all.d_sigma_mm, strict=False)
    ]
    if np.isfinite(lumps.fines_share):
        tiles.append(Tile("fines", f"{100 * lumps.fines_share:.0f}", "%", "of the load's visible surface"))
    if lumps.oversize is not None:
        chance = f"{100 * lumps.oversize.probability:.0f}"
        tiles.append(Tile("oversize", chance, "%", f"that one is over {lumps.oversize.limit_mm:g} mm"))
    caption = "Numbers: as in the table of the largest. Sizes of pale lumps are less sure."
    return [Tiles(tiles), Pictures(make_lump_panels(lumps, depth, picture), caption, columns=2)]


def _sizes(lumps: Lumps) -> list[Item]:
    rows = [
        [f"{sieve:g}", _percent(share), _percent(whole)]
        for sieve, share, whole in zip(
            lumps.all.sieves_mm, lumps.all.passing, lumps.whole.passing, strict=True
        )
    ]
    fines = f"Lumps below {lumps.smallest_mm:.0f} mm are not distinguished and left out as fines."
    return [
        make_distribution_chart(lumps),
        Table(["sieve mm", "passing, all lumps", "fully visible ones"], rows),
        Lines([fines]),
    ]


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if np.isfinite(share) else "–"


def make_distribution_chart(lumps: Lumps) -> Chart:
    """Return the distribution of the sizes as a chart."""
    entries = [
        Entry(f"{name} ({len(chosen)})", role, mark)
        for name, whole, role, mark in _CURVES
        if (chosen := _select_lumps(lumps, whole))
    ]
    if lumps.oversize is not None:
        entries.append(Entry(f"over {lumps.oversize.limit_mm:g} mm is oversize", "limit", "dotted"))
    caption = "Share of the mass in lumps smaller than a size, with d10 to d90 of all and their σ; numbers of lumps."
    return Chart.draw(partial(plot_distribution, lumps), caption, Key(entries))


def plot_distribution(lumps: Lumps, form: Form) -> Figure:
    """Plot passing curves and size histograms of all and of the fully visible lumps."""
    figure, (curve, count) = make_panels(2, form, columns=2, height=300, narrow_height=220)
    for _, whole, role, mark in _CURVES:
        chosen = sorted(_select_lumps(lumps, whole), key=lambda lump: lump.size_mm)
        if chosen:
            size = np.array([lump.size_mm for lump in chosen])
            mass = np.array([lump.volume_mm3 for lump in chosen])
            passing = 100 * (np.cumsum(mass) - mass / 2) / mass.sum()
            style = "--" if mark == "dashed" else "-"
            curve.plot(size, passing, style, color=light(role))
            count.hist(
                size, bins=_bins(lumps), histtype="step", linestyle=style, linewidth=1.6, color=light(role)
            )
    for share, d, sigma in zip((10, 50, 80, 90), lumps.all.d_mm, lumps.all.d_sigma_mm, strict=True):
        if np.isfinite(d):
            curve.errorbar(d, share, xerr=sigma, fmt="o", color=light("first"), markersize=4, capsize=3)
            curve.annotate(f"d{share} {d:.0f}", (d, share), xytext=(7, -12), textcoords="offset points")
    for axis, label, title in ((curve, "smaller, % of mass", "by mass"), (count, "lumps", "by number")):
        if lumps.oversize is not None:
            axis.axvline(lumps.oversize.limit_mm, color=light("limit"), linewidth=1.5, linestyle=":")
        axis.set(xlabel="size, mm", ylabel=label, title=title)
        axis.grid()
    curve.set_ylim(0, 100)
    return figure


def _select_lumps(lumps: Lumps, whole: bool) -> list[Lump]:
    return [lump for lump in lumps.lumps if not lump.cut and not (whole and lump.occluded)]


def _bins(lumps: Lumps) -> NDArray[np.float64]:
    sizes = [lump.size_mm for lump in lumps.lumps if not lump.cut]
    return np.linspace(0, max(sizes, default=1.0), 25)


def _table(lumps: Lumps) -> Table:
    chance = dict(lumps.oversize.lumps) if lumps.oversize is not None else {}
    columns = [
        "number",
        "size mm",
        "σ mm",
        "length mm",
        "width mm",
        "height mm",
        "volume cm³",
        "hidden",
        "cut",
    ]
    columns.append(f"place x, y mm ({lumps.frame})")
    rows: list[list[str]] = []
    for lump in largest_lumps(lumps):
        row = [str(lump.number), f"{lump.size_mm:.1f}", f"{lump.sigma_mm:.1f}", f"{lump.length_mm:.1f}"]
        row += [
            f"{lump.width_mm:.1f}",
            f"{lump.height_mm:.1f}",
            f"{lump.volume_mm3 / 1000:.1f}",
            f"{lump.hidden:.0%}",
        ]
        row += ["yes" if lump.cut else "no", f"{lump.center_mm[0]:.0f}, {lump.center_mm[1]:.0f}"]
        if lumps.oversize is not None:
            row.append(f"{chance.get(lump.number, 0.0):.0%}")
        rows.append(row)
    return Table([*columns, *(["oversize"] if lumps.oversize is not None else [])], rows)
