"""The volume's report: how much, how sure, and what it looks like."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.patches import Rectangle

from beltscape.measure.volume import Volume
from beltscape.report.page import Figure, Item, Section, Table, Tile, Tiles, render
from beltscape.report.pictures import span
from beltscape.report.plots import panels, to_png


def volume_page(volume: Volume, *, warnings: Sequence[str]) -> str:
    """report.html of a volume."""
    sections = [
        Section("The load", "Heights above the empty belt, in the belt frame.", volume_items(volume)),
        Section(
            "How sure, and where its weight acts",
            "Of an evenly dense load; x across, y along the belt, z up from the belt's level middle.",
            [sigma_table(volume), centre_table(volume)],
        ),
        Section(
            "Cross-sections",
            "Each is the mean over its stretch of belt; area times length adds up to the volume.",
            [Figure.png(profiles_plot(volume), "Load above the empty belt."), _profile_table(volume)],
        ),
    ]
    return render("Volume on the belt", verdict(volume), sections, warnings=warnings)


def litres(volume_mm3: float) -> str:
    """Volume in litres with sensible digits."""
    return f"{volume_mm3 * 1e-6:.3f}"


def verdict(volume: Volume) -> str:
    """The result in a sentence."""
    return (
        f"{litres(volume.volume_mm3)} ± {litres(volume.sigma_mm3)} litres between x = {volume.across_mm[0]:.0f} … "
        f"{volume.across_mm[1]:.0f} mm and y = {volume.along_mm[0]:.0f} … {volume.along_mm[1]:.0f} mm; "
        f"{volume.coverage:.1%} of that belt was measured, the rest is interpolated."
    )


def volume_items(volume: Volume) -> list[Item]:
    """Numbers and height map."""
    length = volume.along_mm[1] - volume.along_mm[0]
    return [
        Tiles(
            [
                Tile("volume", litres(volume.volume_mm3), "l", f"σ {litres(volume.sigma_mm3)} l"),
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
        Figure.png(
            height_plot(volume),
            "Height of the load; the box and the centre of gravity in white, interpolated cells veiled grey.",
        ),
    ]


def _load_tiles(volume: Volume) -> list[Tile]:
    """Fill level, highest place, how eccentrically the belt is loaded."""
    full, summit, centre = volume.fullness, volume.summit, volume.centre
    of = "of the whole belt" if full.whole_belt else "of the part of the belt that was seen"
    tiles = [Tile("full", f"{100 * full.level:.0f}", "%", f"{full.capacity_mm2 / 100:.0f} cm² {of}")]
    if summit is not None:
        where = f"at x {summit.place_mm[0]:.0f}, y {summit.place_mm[1]:.0f} mm"
        tiles.append(Tile("highest", f"{summit.height_mm:.1f}", "mm", where))
    if centre is not None:
        sigma = f"σ {centre.off_middle_sigma_mm:.1f} mm"
        tiles.append(Tile("load off the middle", f"{centre.off_middle_mm:+.1f}", "mm", sigma))
    return tiles


def sigma_table(volume: Volume) -> Table:
    """What the uncertainty is put together from."""
    causes = volume.causes
    rows = (
        ("places that no camera measured", causes.holes_mm3),
        ("where steps lie", causes.edges_mm3),
        ("noise of the depth map", causes.noise_mm3),
        ("the empty belt", causes.belt_mm3),
        ("slow errors of the depth map", causes.drift_mm3),
        ("together (root of the sum of squares)", volume.sigma_mm3),
    )
    return Table(["cause", "σ, litres"], [[name, f"{value * 1e-6:.4f}"] for name, value in rows])


def centre_table(volume: Volume) -> Table:
    """The centre of gravity."""
    centre = volume.centre
    if centre is None:
        return Table(["centre of gravity", "mm", "σ"], [["none: hardly any load", "–", "–"]])
    rows = [
        [name, f"{value:.1f}", f"{sigma:.1f}"]
        for name, value, sigma in zip("xyz", centre.place_mm, centre.sigma_mm, strict=True)
    ]
    off = [f"{centre.off_middle_mm:+.1f}", f"{centre.off_middle_sigma_mm:.1f}"]
    return Table(["centre of gravity", "mm", "σ"], [*rows, ["off the belt's middle", *off]])


def height_plot(volume: Volume) -> bytes:
    """The load's height map with the box and what was interpolated."""
    load = volume.load
    half = load.cell_mm / 2
    extent = (load.x_mm[0] - half, load.x_mm[-1] + half, load.y_mm[0] - half, load.y_mm[-1] + half)
    figure, (axis,) = panels(1, columns=1, width=9.5, height=5.6)
    low, high = span(load.height_mm, 0.002)
    image = axis.imshow(
        load.height_mm,
        origin="lower",
        extent=extent,
        cmap="turbo",
        vmin=min(low, 0),
        vmax=high,
        interpolation="nearest",
    )
    veil = np.zeros((*volume.interpolated.shape, 4))
    veil[volume.interpolated] = (0.5, 0.5, 0.5, 0.55)
    axis.imshow(veil, origin="lower", extent=extent, interpolation="nearest")
    (x0, x1), (y0, y1) = volume.across_mm, volume.along_mm
    axis.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, edgecolor="white", linewidth=1.6))
    if volume.centre is not None:
        axis.plot(*volume.centre.place_mm[:2], "+", color="white", markersize=14, markeredgewidth=2)
    axis.set(xlabel="x across, mm", ylabel="y along, mm", xlim=extent[:2], ylim=extent[2:])
    figure.colorbar(image, ax=axis, label="height, mm", shrink=0.85)
    return to_png(figure)


def profiles_plot(volume: Volume) -> bytes:
    """All cross-sections over one another, coloured along the belt."""
    import matplotlib as mpl

    figure, (axis,) = panels(1, columns=1, width=9.5, height=3.4)
    colors = mpl.colormaps["viridis"](np.linspace(0.05, 0.92, max(len(volume.profiles), 1)))
    for color, profile in zip(colors, volume.profiles, strict=False):
        axis.plot(profile.x_mm, profile.height_mm, color=color, linewidth=1.3, label=f"{profile.y_mm:.0f}")
    axis.set(xlabel="x across, mm", ylabel="height, mm")
    axis.grid(color="#e9ecef")
    axis.legend(title="y, mm", ncols=2, fontsize=7, title_fontsize=8, frameon=False, loc="upper right")
    return to_png(figure)


def _profile_table(volume: Volume) -> Table:
    return Table(
        ["y mm", "area cm²", "measured"],
        [[f"{p.y_mm:.1f}", f"{p.area_mm2 / 100:.2f}", f"{p.coverage:.1%}"] for p in volume.profiles],
    )
