"""The lumps' report: which lumps, how large, how they are distributed, and what is too large."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.depth import DepthMap
from beltscape.core.frames import Image, grey
from beltscape.measure.lumps.lumps import BIAS, FINES, Lumps
from beltscape.measure.lumps.shape import Lump
from beltscape.report.legend import TURBO, Color, Rgb, Scale, Swatches, text_width, write
from beltscape.report.page import Figure, Item, Lines, Section, Table, Tile, Tiles, render
from beltscape.report.pictures import panel, sheet, span, to_rgb
from beltscape.report.plots import panels, to_png

_ALARM: Color = (224, 49, 49)
_BARE, _FINES = (238, 240, 242), (178, 184, 190)
_LARGEST = 12
"""Rows of the table."""
_LIGHT = np.array([-1.0, -1.0, -2.0]) / np.sqrt(6.0)


def lumps_page(lumps: Lumps, depth: DepthMap, picture: Image | None) -> str:
    """report.html of a frame's lumps."""
    sections = [
        Section("Lumps in view", "Each lump in the colour of its size.", _view(lumps, depth, picture)),
        Section("Size distribution", BIAS, _sizes(lumps)),
        Section("The largest", "Sizes with one standard deviation.", [_table(lumps)]),
    ]
    return render("Lumps on the belt", verdict(lumps), sections)


def verdict(lumps: Lumps) -> str:
    """The result in a sentence or two."""
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
    caption = "Pale: partly hidden by others, or cut by the frame; their sizes are less sure."
    if lumps.oversize is not None:
        caption += f" Red outline and number: over {lumps.oversize.limit_mm:g} mm."
    return [Tiles(tiles), Figure.of(lumps_picture(lumps, depth, picture), caption)]


def lumps_picture(lumps: Lumps, depth: DepthMap, picture: Image | None) -> Rgb:
    """(H', W', 3): lumps coloured by size on the relief, outlined; beside it what the camera saw, outlined."""
    area = _area(lumps)
    labels, relief = lumps.labels[area], _relief(depth)[area]
    size = np.full(FINES + 1, np.nan)
    pale = np.zeros(FINES + 1, bool)
    for lump in lumps.lumps:
        size[lump.number] = lump.size_mm
        pale[lump.number] = lump.occluded or lump.cut
    low, high = span(size, 0.02)
    scale = Scale(low, high, TURBO[18:240])
    colored = scale.colored(size[labels]).astype(np.float64)
    weight = np.where(pale[labels], 0.45, 1.0)[..., None]
    colored = weight * colored + (1 - weight) * 235
    colored[labels == 0] = _BARE
    colored[labels == FINES] = _FINES
    shaded = np.clip(colored * relief[..., None], 0, 255).astype(np.uint8)
    edge = _edges(labels)
    left = _drawn(shaded, edge, (33, 37, 41))
    _mark_oversize(left, labels, lumps)
    key = Swatches([("no lump", _BARE if not (labels == FINES).any() else _FINES)])
    one = panel(left, "size of the lumps, mm", scale, key=key)
    if picture is None:
        return one
    smooth = cv2.GaussianBlur(grey(picture), (0, 0), max(labels.shape) / 500)  # without the projected dots
    seen = to_rgb(np.asarray(smooth)[area])
    right = _drawn(seen, edge, (255, 169, 77))
    return sheet([one, panel(right, "what the core camera saw, with the outlines", key)], 2)


def _area(lumps: Lumps) -> tuple[slice, slice]:
    """Where there are lumps, with a rim; all of it without."""
    there = np.argwhere(lumps.labels > 0)
    if not len(there):
        return np.s_[:, :]
    rim = max(lumps.labels.shape) // 40
    (top, left), (bottom, right) = there.min(axis=0), there.max(axis=0)
    return np.s_[max(top - rim, 0) : bottom + rim, max(left - rim, 0) : right + rim]


def _relief(depth: DepthMap) -> NDArray[np.float64]:
    """(H, W) brightness, about 1, of the surface lit from above left."""
    known = depth.measured
    middle = float(np.median(depth.depth_mm[known])) if known.any() else 1.0
    z = cv2.medianBlur(np.where(known, depth.depth_mm, middle).astype(np.float32), 5)
    z = cv2.GaussianBlur(z, (0, 0), 1.2)
    pixel = middle / (1.0 * max(depth.depth_mm.shape))  # the lens' angle is about one radian
    down, right = np.gradient(z.astype(np.float64))
    normal = np.stack([right / pixel, down / pixel, -np.ones_like(down)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    light = np.clip(normal @ _LIGHT, 0, None)
    light = np.where(known, light, 0.5)
    return np.clip(0.45 + 0.7 * light, 0.3, 1.2)


def _edges(labels: NDArray[np.uint16]) -> NDArray[np.bool_]:
    edge = np.zeros(labels.shape, bool)
    edge[:, 1:] |= labels[:, 1:] != labels[:, :-1]
    edge[1:] |= labels[1:] != labels[:-1]
    lump = (labels > 0) & (labels < FINES)
    return edge & np.asarray(ndimage.binary_dilation(lump, np.ones((3, 3))), bool)


def _drawn(image: Rgb, edge: NDArray[np.bool_], color: Color) -> Rgb:
    thick = max(1, round(max(image.shape[:2]) / 600))
    wide = np.asarray(ndimage.binary_dilation(edge, np.ones((thick, thick))), bool) if thick > 1 else edge
    drawn = image.copy()
    drawn[wide] = color
    return drawn


def _mark_oversize(image: Rgb, labels: NDArray[np.uint16], lumps: Lumps) -> None:
    """Red outlines and sizes of what is over the limit, in place."""
    over = [] if lumps.oversize is None else [n for n, chance in lumps.oversize.lumps if chance > 0.5]
    height = max(14, image.shape[1] // 42)
    for number in over:
        own = (labels == number).astype(np.uint8)
        outline, _ = cv2.findContours(own, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(image, outline, -1, _ALARM, max(2, image.shape[1] // 260))
        rows, columns = np.nonzero(own)
        if not len(rows):
            continue
        text = f"{lumps.lumps[number - 1].size_mm:.0f}"
        where = (int(columns.mean()) - text_width(text, height) // 2, int(rows.mean()) + height // 3)
        for shift in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            write(image, text, (where[0] + shift[0], where[1] + shift[1]), height, (255, 255, 255))
        write(image, text, where, height, _ALARM)


def _sizes(lumps: Lumps) -> list[Item]:
    rows = [
        [f"{sieve:g}", _percent(share), _percent(whole)]
        for sieve, share, whole in zip(
            lumps.all.sieves_mm, lumps.all.passing, lumps.whole.passing, strict=True
        )
    ]
    fines = f"Lumps below {lumps.smallest_mm:.0f} mm are not told apart and left out as fines."
    return [
        Figure.png(distribution_plot(lumps), "Share of the mass in lumps smaller than a size."),
        Table(["sieve mm", "passing, all lumps", "fully visible ones"], rows),
        Lines([fines]),
    ]


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if np.isfinite(share) else "–"


def distribution_plot(lumps: Lumps) -> bytes:
    """Passing curves of all and of the fully visible lumps with d50 and d80, and how many there are of each size."""
    figure, (curve, count) = panels(2, columns=2, width=5.2, height=3.6)
    for name, sizes, chosen, color, style in (
        ("all lumps", lumps.all, _chosen(lumps, False), "#1864ab", "-"),
        ("fully visible", lumps.whole, _chosen(lumps, True), "#e8590c", "--"),
    ):
        if not chosen:
            continue
        order = sorted(chosen, key=lambda lump: lump.size_mm)
        size = np.array([lump.size_mm for lump in order])
        mass = np.array([lump.volume_mm3 for lump in order])
        curve.plot(
            size,
            100 * (np.cumsum(mass) - mass / 2) / mass.sum(),
            style,
            color=color,
            label=f"{name} ({sizes.count})",
        )
        count.hist(size, bins=_bins(lumps), color=color, alpha=0.75, label=name)
    for share, d, sigma in zip((10, 50, 80, 90), lumps.all.d_mm, lumps.all.d_sigma_mm, strict=True):
        if np.isfinite(d):
            curve.errorbar(d, share, xerr=sigma, fmt="o", color="#1864ab", markersize=4, capsize=3)
            curve.annotate(
                f"d{share} {d:.0f}", (d, share), xytext=(8, -9), textcoords="offset points", fontsize=8
            )
    if lumps.oversize is not None:
        for axis in (curve, count):
            axis.axvline(lumps.oversize.limit_mm, color="#e03131", linewidth=1, linestyle=":")
    curve.set(xlabel="size, mm", ylabel="smaller, % of mass", ylim=(0, 100), title="by mass")
    count.set(xlabel="size, mm", ylabel="lumps", title="by number")
    for axis in (curve, count):
        axis.grid(color="#e9ecef")
        axis.set_axisbelow(True)
    if curve.get_legend_handles_labels()[0]:
        curve.legend(frameon=False, fontsize=8, loc="lower right")
        count.legend(frameon=False, fontsize=8)
    return to_png(figure)


def _chosen(lumps: Lumps, whole: bool) -> list[Lump]:
    return [lump for lump in lumps.lumps if not lump.cut and not (whole and lump.occluded)]


def _bins(lumps: Lumps) -> NDArray[np.float64]:
    sizes = [lump.size_mm for lump in lumps.lumps if not lump.cut]
    return np.linspace(0, max(sizes, default=1.0), 25)


def _table(lumps: Lumps) -> Table:
    largest = sorted(lumps.lumps, key=lambda lump: -lump.size_mm)[:_LARGEST]
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
    rows = []
    for lump in largest:
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
