"""The report page of the lumps of a frame or of a fused belt: sizes, size distribution and oversize.

Its pictures show the lumps coloured by size on the shaded surface, and outlined on the camera image of a frame.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.depth import DepthMap
from beltscape.core.frames import Image, to_grey
from beltscape.core.height_map import HeightMap
from beltscape.measure.lumps.lumps import BIAS, FINES, FUSED_BELT, Lump, Lumps
from beltscape.report.drawing.charts import Chart, ChartKey, KeyEntry
from beltscape.report.drawing.charts import Mark as ChartMark
from beltscape.report.drawing.depth_picture import LIGHT
from beltscape.report.drawing.legend import HEIGHT, Color, Rgb, Scale, Swatches
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.pictures import Mark, Panel, quantile_range, to_rgb
from beltscape.report.drawing.plots import Form, make_panels
from beltscape.report.page import Item, Lines, Pictures, Section, Table, Tile, Tiles, render

OVERSIZE: Color = (217, 0, 130)
"""Outline of oversize lumps; no other colour has this hue."""
BELT, FINE = (238, 240, 242), (178, 184, 190)
"""Colours without lumps: the bare belt, and fines."""
_OUTLINE, _SEEN_OUTLINE = (33, 37, 41), (255, 169, 77)
"""Colours of the outlines over the sizes, and over the image."""
_PALE, _PALE_TO = 0.45, 235
"""Share of its colour that a partly visible lump keeps, and the grey of the rest."""
_LARGEST = 12
"""Smallest number of numbered lumps in the table; all oversize lumps are added."""


def largest_lumps(lumps: Lumps) -> list[Lump]:
    """Return the lumps of the table in descending size; the pictures number these."""
    count = max(_LARGEST, len(_oversize_numbers(lumps)))
    return sorted(lumps.lumps, key=lambda lump: -lump.size_mm)[:count]


def make_lump_panels(lumps: Lumps, surface: DepthMap | HeightMap, picture: Image | None) -> list[Panel]:
    """Return the lumps outlined on the surface coloured by size, and outlined on the camera image."""
    if isinstance(surface, HeightMap):
        return _make_belt_panels(lumps, surface)
    area = crop_to_lumps(lumps)
    labels = lumps.labels[area]
    scale = _make_size_scale(lumps)
    marks = _marks(lumps, labels)
    sized = _draw_outlines(
        color_by_size(labels, lumps, _shade_relief(surface)[area], scale), labels, lumps, _OUTLINE
    )
    panels = [Panel(sized, "size of the lumps, mm", scale, _key(labels, lumps), marks=marks)]
    if picture is not None:
        smooth = cv2.GaussianBlur(
            to_grey(picture), (0, 0), max(labels.shape) / 500
        )  # without the projected dots
        seen = _draw_outlines(to_rgb(np.asarray(smooth)[area]), labels, lumps, _SEEN_OUTLINE)
        outlines = Swatches([("outline of a lump", _SEEN_OUTLINE), *_oversize_swatch(lumps)])
        panels.append(Panel(seen, "what the core camera saw", outlines, marks=marks))
    return panels


def _make_size_scale(lumps: Lumps) -> Scale:
    return Scale(*quantile_range(_size_by_label(lumps), 0.02), HEIGHT[40:])


_PIECE_ROWS, _MOST_PIECES = 1600, 12
"""Rows of the fused belt in a picture, and largest number of pictures; of a longer belt fewer rows are drawn."""


def _make_belt_panels(lumps: Lumps, heights: HeightMap) -> list[Panel]:
    """Return the lumps of a fused belt coloured by size, in pieces; the belt travels to the left."""
    rows, _ = crop_to_lumps(lumps)
    first, end, _ = rows.indices(len(lumps.labels))
    every = max(1, -(-(end - first) // (_PIECE_ROWS * _MOST_PIECES)))
    count = max(1, -(-(end - first) // (_PIECE_ROWS * every)))
    scale, key, relief = _make_size_scale(lumps), _key(lumps.labels, lumps), _shade_heights(heights)
    panels: list[Panel] = []
    for number, part in enumerate(np.array_split(np.arange(first, end), count)):
        area = np.ix_(part[::every], np.arange(0, lumps.labels.shape[1], every))
        labels = np.ascontiguousarray(lumps.labels[area].T)
        colors = color_by_size(labels, lumps, relief[area].T, scale)
        start, stop = (float(heights.y_mm[row]) for row in (part[0], part[-1]))
        title = f"size of the lumps, mm; belt coordinate {start:.0f} to {stop:.0f} mm"
        legend = (scale, key) if number == 0 else (None, None)
        drawn = _draw_outlines(colors, labels, lumps, _OUTLINE)
        panels.append(Panel(drawn, title, *legend, marks=_marks(lumps, labels)))
    return panels


def _shade_heights(heights: HeightMap) -> NDArray[np.float64]:
    """Return the shading (Ny, Nx) of a height map lit from above left; 1 where it is level or not in view."""
    known = np.isfinite(heights.height_mm)
    z = cv2.medianBlur(np.where(known, heights.height_mm, 0.0).astype(np.float32), 5)
    z = cv2.GaussianBlur(z, (0, 0), 1.2)
    return _shade(-z, heights.cell_mm, known)


def color_by_size(labels: NDArray[np.uint16], lumps: Lumps, relief: NDArray[np.float64], scale: Scale) -> Rgb:
    """Return the shaded lumps in the colours of their sizes, (H, W, 3); pixels without lumps in the key's colours."""
    pale = np.zeros(FINES + 1, bool)
    for lump in lumps.lumps:
        pale[lump.number] = lump.occluded or lump.cut
    colored = scale.to_rgb(_size_by_label(lumps)[labels]).astype(np.float64)
    weight = np.where(pale[labels], _PALE, 1.0)[..., None]
    shaded = (weight * colored + (1 - weight) * _PALE_TO) * relief[..., None]
    image = np.rint(np.clip(shaded, 0, 255)).astype(np.uint8)
    image[labels == 0] = BELT
    image[labels == FINES] = FINE
    return image


def _size_by_label(lumps: Lumps) -> NDArray[np.float64]:
    """Return the size of each label, (FINES + 1,) mm; NaN: no lump."""
    size = np.full(FINES + 1, np.nan)
    for lump in lumps.lumps:
        size[lump.number] = lump.size_mm
    return size


def _key(labels: NDArray[np.uint16], lumps: Lumps) -> Swatches:
    """Return the key of the colours that are no sizes."""
    entries: list[tuple[str, Color]] = []
    if (labels == 0).any():
        entries.append(("no lump", BELT))
    if (labels == FINES).any():
        entries.append(("fines", FINE))
    if any(lump.occluded or lump.cut for lump in lumps.lumps):
        middle = np.asarray(HEIGHT[148], np.float64)
        red, green, blue = (round(_PALE * float(c) + (1 - _PALE) * _PALE_TO) for c in middle)
        entries.append(("pale: partly hidden, or cut by the view's ends", (red, green, blue)))
    return Swatches([*entries, *_oversize_swatch(lumps)])


def _oversize_swatch(lumps: Lumps) -> list[tuple[str, Color]]:
    return (
        [(f"over {lumps.oversize.limit_mm:g} mm", OVERSIZE)]
        if lumps.oversize and _oversize_numbers(lumps)
        else []
    )


def _oversize_numbers(lumps: Lumps) -> list[int]:
    """Return the numbers of the lumps whose probability of oversize exceeds one half."""
    return [] if lumps.oversize is None else [n for n, chance in lumps.oversize.lumps if chance > 0.5]


def _marks(lumps: Lumps, labels: NDArray[np.uint16]) -> list[Mark]:
    """Return the numbers of the largest lumps, each on its lump."""
    marks: list[Mark] = []
    height, width = labels.shape
    for lump in largest_lumps(lumps):
        own = labels == lump.number
        if own.any():
            v, u = _find_innermost(own)
            marks.append(Mark(str(lump.number), ((u + 0.5) / width, (v + 0.5) / height)))
    return marks


def _find_innermost(own: NDArray[np.bool_]) -> tuple[int, int]:
    """Return row and column of the pixel farthest from the edge."""
    inside = ndimage.distance_transform_edt(np.pad(own, 1))
    v, u = np.unravel_index(int(np.argmax(inside)), own.shape + np.array([2, 2]))
    return int(v) - 1, int(u) - 1


def crop_to_lumps(lumps: Lumps) -> tuple[slice, slice]:
    """Return the rows and columns that contain lumps, with a margin; all without lumps."""
    there = np.argwhere(lumps.labels > 0)
    if not len(there):
        return np.s_[:, :]
    rim = max(lumps.labels.shape) // 40
    (top, left), (bottom, right) = there.min(axis=0), there.max(axis=0)
    return np.s_[max(top - rim, 0) : bottom + rim, max(left - rim, 0) : right + rim]


def _shade_relief(depth: DepthMap) -> NDArray[np.float64]:
    """Return the shading (H, W) of the surface lit from above left; 1 where it is level or not measured."""
    measured = depth.measured
    middle = float(np.median(depth.depth_mm[measured])) if measured.any() else 1.0
    z = cv2.medianBlur(np.where(measured, depth.depth_mm, middle).astype(np.float32), 5)
    z = cv2.GaussianBlur(z, (0, 0), 1.2)
    # the lens' angle is about one radian
    return _shade(z, middle / (1.0 * max(depth.depth_mm.shape)), measured)


def _shade(z: NDArray[Any], pixel: float, measured: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the shading (H, W) of smooth depths (H, W) with pixels of a width."""
    down, right = np.gradient(z.astype(np.float64))
    normal = np.stack([right / pixel, down / pixel, -np.ones_like(down)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    brighter = np.clip(normal @ LIGHT, 0, None) + LIGHT[2]
    return np.clip(1.0 + 0.7 * np.where(measured, brighter, 0.0), 0.3, 1.2)


def _draw_outlines(image: Rgb, labels: NDArray[np.uint16], lumps: Lumps, color: Color) -> Rgb:
    """Return the image (H, W, 3) with the outlines of all lumps, and those of oversize lumps on top."""
    thick = max(1, round(max(image.shape[:2]) / 600))
    edge = _edges(labels)
    wide = np.asarray(ndimage.binary_dilation(edge, np.ones((thick, thick))), bool) if thick > 1 else edge
    drawn = image.copy()
    drawn[wide] = color
    for number in _oversize_numbers(lumps):
        own = (labels == number).astype(np.uint8)
        outline, _ = cv2.findContours(own, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(drawn, outline, -1, OVERSIZE, max(2, image.shape[1] // 260))
    return drawn


def _edges(labels: NDArray[np.uint16]) -> NDArray[np.bool_]:
    edge = np.zeros(labels.shape, bool)
    edge[:, 1:] |= labels[:, 1:] != labels[:, :-1]
    edge[1:] |= labels[1:] != labels[:-1]
    lump = (labels > 0) & (labels < FINES)
    return edge & np.asarray(ndimage.binary_dilation(lump, np.ones((3, 3))), bool)


_CURVES: tuple[tuple[str, bool, str, ChartMark], ...] = (
    ("all lumps", False, "first", "line"), ("fully visible", True, "second", "dashed"),
)  # fmt: skip
"""(name, whether of fully visible lumps only, role of the palette, mark)."""


def render_lumps_page(lumps: Lumps, surface: DepthMap | HeightMap, picture: Image | None = None) -> str:
    """Return report.html of the lumps of a frame, or of a fused belt."""
    sections = [
        Section("Lumps in view", "Each lump in the colour of its size.", _view(lumps, surface, picture)),
        Section("Size distribution", BIAS, _list_size_items(lumps)),
        Section("The largest", "Sizes with one standard deviation.", [_table(lumps)]),
    ]
    return render("Lumps on the belt", summarise_lumps(lumps), sections)


def summarise_lumps(lumps: Lumps) -> str:
    """Return the result in a sentence or two."""
    if not lumps.lumps:
        return "No lumps in view."
    whole = sum(not lump.occluded and not lump.cut for lump in lumps.lumps)
    text = f"{len(lumps.lumps)} lumps in view, {whole} of them fully visible"
    d50, sigma = lumps.all.d_mm[1], lumps.all.d_sigma_mm[1]
    if np.isfinite(d50):
        text += f"; half of the mass is in lumps below {d50:.0f} ± {sigma:.0f} mm"
    else:
        text += "; the view cuts all but one at most, so that they have no size distribution"
    alarm = lumps.oversize
    if alarm is None:
        return text + "."
    over = sum(chance > 0.5 for _, chance in alarm.lumps)
    if alarm.alarm:
        return f"{text}. Oversize: {over} over {alarm.limit_mm:g} mm."
    return f"{text}. None over {alarm.limit_mm:g} mm (probability of one {alarm.probability:.0%})."


def _view(lumps: Lumps, surface: DepthMap | HeightMap, picture: Image | None) -> list[Item]:
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
    columns = 1 if isinstance(surface, HeightMap) else 2
    return [Tiles(tiles), Pictures(make_lump_panels(lumps, surface, picture), caption, columns=columns)]


def _list_size_items(lumps: Lumps) -> list[Item]:
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
        KeyEntry(f"{name} ({len(chosen)})", role, mark)
        for name, whole, role, mark in _CURVES
        if (chosen := _select_lumps(lumps, whole))
    ]
    if lumps.oversize is not None:
        entries.append(KeyEntry(f"over {lumps.oversize.limit_mm:g} mm is oversize", "limit", "dotted"))
    caption = "Share of the mass in lumps smaller than a size, with d10 to d90 of all and their σ; numbers of lumps."
    return Chart.draw(partial(plot_distribution, lumps), caption, ChartKey(entries))


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
    columns.append(
        "place x, s mm (fused belt)" if lumps.frame == FUSED_BELT else f"place x, y mm ({lumps.frame})"
    )
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
