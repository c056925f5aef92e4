"""The report of a moving belt: how much passed, how sure, and what it looked like."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.belt import HeightMap
from beltscape.core.flow import QUALITIES, FlowRecord
from beltscape.measure.flow.meter import Step
from beltscape.measure.flow.totals import FlowTotals
from beltscape.report.page import Figure, Section, Table, Tile, Tiles, render
from beltscape.report.pictures import span
from beltscape.report.plots import panels, to_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLORS = {"measured": "#2b8a3e", "degraded": "#f08c00", "bridged": "#1971c2", "missing": "#c92a2a"}
_MATERIAL, _ENCODER, _QUIET = "#0b7285", "#d9480f", "#adb5bd"
_MOST_ROWS = 400
_ROW_MM = 3000.0
"""A long belt is drawn in pieces of about this length, one below the other."""
_MOST_PIECES = 12


@dataclass(frozen=True, slots=True, eq=False)
class FlowReport:
    """What the page shows."""

    records: Sequence[FlowRecord]
    steps: Sequence[Step]
    totals: FlowTotals
    document: Mapping[str, Any]
    """The figures of flow.json."""
    belt: HeightMap
    """The fused belt, columns x, rows s."""
    share: NDArray[np.float64]
    """Share of its cells that were measured."""


def flow_page(flow: FlowReport, *, warnings: Sequence[str]) -> str:
    """report.html of a moving belt."""
    sections = [
        Section("What passed", "", [Tiles(_tiles(flow))]),
        Section(
            "The belt",
            "All frames laid over one another where the belt had moved to: load above the empty belt. It travels to "
            "the left; interpolated places are veiled.",
            [Figure.png(belt_plot(flow), "Fused surface over the belt coordinate s.")],
        ),
        Section(
            "Flow",
            "Every record is the strip of belt that became new in its frame; the strips meet without gap or overlap, "
            "so their volumes add up to the total.",
            [
                Figure.png(flow_plot(flow), "Cross-section along the belt with two σ, and flow over time."),
                _key(),
            ],
        ),
        Section(
            "The belt's motion",
            "Found by laying successive height maps over one another; the projected pattern stands still and cannot "
            "tell it.",
            [Figure.png(motion_plot(flow), "Speed by the material and by the encoder; what they differ by.")],
        ),
        Section(
            "What fusion adds",
            "The material meets other dots, markers and shadows in every frame.",
            [Figure.png(coverage_plot(flow), "Share of each strip that was measured."), _fusion_table(flow)],
        ),
        Section("Strips", "", [_strip_table(flow.records)]),
    ]
    return render("Flow on the belt", verdict(flow), sections, warnings=warnings)


def verdict(flow: FlowReport) -> str:
    """The result in a sentence."""
    totals, document = flow.totals, flow.document
    text = (
        f"{totals.volume_mm3 * 1e-6:.3f} ± {totals.sigma_mm3 * 1e-6:.3f} litres passed on "
        f"{totals.length_mm / 1000:.2f} m of belt towards {document['direction'] or '?'}"
    )
    if np.isfinite(totals.mass_kg):
        text += f", {totals.mass_kg:.2f} ± {totals.mass_sigma_kg:.2f} kg"
    if totals.bridged_mm > 0:
        text += f"; {totals.bridged_mm:.0f} mm of it in no frame, and interpolated"
    if totals.unseen_mm > 1:
        text += f"; {totals.unseen_mm:.0f} mm more are not counted: nothing tells what lay there"
    return text + "."


def _tiles(flow: FlowReport) -> list[Tile]:
    totals, document = flow.totals, flow.document
    relative = 100 * totals.sigma_mm3 / totals.volume_mm3 if totals.volume_mm3 > 0 else float("nan")
    mean = document["totals"]["mean_volume_flow_m3_h"]
    speeds = [record.speed_mm_s for record in flow.records if np.isfinite(record.speed_mm_s)]
    tiles = [
        Tile(
            "total volume",
            f"{totals.volume_mm3 * 1e-6:.3f}",
            "l",
            f"σ {totals.sigma_mm3 * 1e-6:.3f} l, {relative:.2f} %",
        )
    ]
    if np.isfinite(totals.mass_kg):
        tiles.append(Tile("total mass", f"{totals.mass_kg:.2f}", "kg", f"σ {totals.mass_sigma_kg:.2f} kg"))
    if mean is not None:
        tiles.append(Tile("mean flow", f"{mean:.1f}", "m³/h", f"over {document['totals']['seconds']:.2f} s"))
    if speeds:
        tiles.append(
            Tile("belt speed", f"{np.median(speeds) / 1000:.3f}", "m/s", f"towards {document['direction']}")
        )
    tiles.append(
        Tile("belt", f"{totals.length_mm / 1000:.2f}", "m", f"{document['frame_count']} frames, each mm once")
    )
    tiles.append(
        Tile(
            "measured",
            f"{100 * totals.share:.1f}",
            "%",
            f"one frame alone: {100 * totals.single_share:.1f} %",
        )
    )
    encoder = document["encoder"]
    if encoder["compared"]:
        off = 100 * (encoder["ratio"] - 1)
        tiles.append(
            Tile("encoder off", f"{off:+.2f}", "%", f"σ {100 * encoder['sigma']:.2f} %, by the material")
        )
    return tiles


def belt_plot(flow: FlowReport) -> bytes:
    """The fused belt in pieces one below the other, seen from above, travelling to the left."""
    belt = flow.belt
    half = belt.cell_mm / 2
    low, high = span(belt.height_mm, 0.002)
    ends = belt.y_mm[0] - half, belt.y_mm[-1] + half
    count = int(np.clip(np.ceil((ends[1] - ends[0]) / _ROW_MM), 1, _MOST_PIECES))
    length = (ends[1] - ends[0]) / count
    width = belt.x_mm[-1] - belt.x_mm[0]
    height = float(np.clip(10.5 * width / length, 1.2, 5.0)) + 0.7
    figure, axes = panels(count, columns=1, width=11.5, height=height)
    extent = (ends[0], ends[1], belt.x_mm[0] - half, belt.x_mm[-1] + half)
    veil = np.zeros((*flow.share.T.shape, 4))
    veil[..., :3] = 1.0
    veil[..., 3] = np.clip(0.75 * (1 - flow.share.T), 0, 1)
    image = None
    for k, axis in enumerate(axes):
        image = axis.imshow(
            belt.height_mm.T, origin="lower", extent=extent, cmap="turbo", vmin=min(low, 0), vmax=max(high, 1),
            interpolation="nearest", aspect="equal",
        )  # fmt: skip
        axis.imshow(veil, origin="lower", extent=extent, interpolation="nearest", aspect="equal")
        for record in flow.records:
            axis.axvline(record.strip_mm[1], color="white", linewidth=0.5, alpha=0.55)
        axis.set(xlim=(ends[0] + k * length, ends[0] + (k + 1) * length), ylabel="x, mm")
    axes[-1].set(xlabel="belt coordinate s, mm; white lines part the strips")
    if image is not None:
        figure.colorbar(image, ax=axes, label="load, mm", shrink=0.8, aspect=15 * count)
    return to_png(figure)


def flow_plot(flow: FlowReport) -> bytes:
    """Cross-section over the belt, and flow over time."""
    timed = [r for r in flow.records if r.time_ns is not None and np.isfinite(r.volume_flow_m3_h)]
    figure, axes = panels(2 if timed else 1, columns=1, width=11.5, height=2.5)
    strips = [r for r in flow.records if r.strip_mm[1] > r.strip_mm[0]]
    for record in strips:
        length = record.strip_mm[1] - record.strip_mm[0]
        area, sigma = record.area_mm2 / 100, record.sigma_mm3 / length / 100
        color = COLORS[record.quality]
        axes[0].fill_between(record.strip_mm, 0, area, color=color, alpha=0.25, linewidth=0)
        axes[0].plot(record.strip_mm, [area, area], color=color, linewidth=1.6)
        axes[0].fill_between(
            record.strip_mm, area - 2 * sigma, area + 2 * sigma, color=color, alpha=0.3, linewidth=0
        )
    axes[0].set(xlabel="belt coordinate s, mm", ylabel="cross-section, cm²")
    if timed:
        time = np.array([(r.time_ns or 0) * 1e-9 for r in timed])
        rate = np.array([r.volume_flow_m3_h for r in timed])
        axes[1].plot(time, rate, color=_QUIET, linewidth=1.0, zorder=1)
        axes[1].scatter(time, rate, c=[COLORS[r.quality] for r in timed], s=18, zorder=2)
        axes[1].set(xlabel="time, s", ylabel="flow, m³/h")
        axes[1].set_ylim(bottom=min(0.0, float(rate.min())))
        if np.isfinite([r.mass_flow_t_h for r in timed]).all():
            _second_scale(axes[1], timed)
    for axis in axes:
        axis.grid(color="#e9ecef")
    return to_png(figure)


def _second_scale(axis: Axes, timed: Sequence[FlowRecord]) -> None:
    """Mass flow on the right, where one density holds for all."""
    densities = {record.density_kg_m3 for record in timed}
    if len(densities) == 1:
        factor = densities.pop() * 1e-3
        right = axis.secondary_yaxis(
            "right", functions=(partial(np.multiply, factor), partial(np.multiply, 1 / factor))
        )
        right.set_ylabel("t/h")


def motion_plot(flow: FlowReport) -> bytes:
    """Speed of material and encoder, and how far the encoder runs away from the material."""
    steps = flow.steps
    both = [s for s in steps if s.place.encoder_mm is not None]
    figure, axes = panels(2 if both else 1, columns=1, width=11.5, height=2.3)
    clock = np.array([s.place.clock for s in steps])
    place = np.array([s.place.position_mm for s in steps])
    sure = np.array([s.place.source == "material" for s in steps], bool)
    if len(steps) > 1:
        middle = 0.5 * (clock[1:] + clock[:-1])
        with np.errstate(divide="ignore", invalid="ignore"):
            axes[0].plot(
                middle, np.diff(place) / np.diff(clock), color=_MATERIAL, linewidth=1.2, label="belt as used"
            )
            axes[0].plot(
                middle[sure[1:]], (np.diff(place) / np.diff(clock))[sure[1:]], "o", color=_MATERIAL, markersize=4,
                label="told by the material",
            )  # fmt: skip
            if len(both) == len(steps):
                encoder = np.array([s.place.encoder_mm for s in both], np.float64)
                speed = np.diff(encoder) / np.diff(clock)
                axes[0].plot(middle, speed, color=_ENCODER, linewidth=1.0, linestyle="--", label="encoder")
        axes[0].legend(frameon=False, fontsize=8, ncols=3)
        axes[0].ticklabel_format(axis="y", useOffset=False)
        low, high = axes[0].get_ylim()
        room = max(0.0, 0.01 * abs(0.5 * (low + high)) - 0.5 * (high - low))  # a steady belt looks steady
        axes[0].set_ylim(low - room, high + room)
    axes[0].set(xlabel="time, s", ylabel="speed, mm/s")
    if both:
        off = [float(s.place.encoder_mm or 0.0) - s.place.position_mm for s in both]
        axes[1].plot([s.place.clock for s in both], off, color=_ENCODER, linewidth=1.3)
        axes[1].axhline(0, color=_QUIET, linewidth=0.8)
        axes[1].set(xlabel="time, s", ylabel="encoder - material, mm")
    for axis in axes:
        axis.grid(color="#e9ecef")
    return to_png(figure)


def coverage_plot(flow: FlowReport) -> bytes:
    """Measured share of every strip: one frame alone, and all together."""
    figure, (axis,) = panels(1, columns=1, width=11.5, height=2.3)
    strips = [r for r in flow.records if r.strip_mm[1] > r.strip_mm[0]]
    edges = [s for record in strips for s in record.strip_mm]
    for values, color, name in (
        ([r.single_coverage for r in strips], _QUIET, "one frame alone"),
        ([r.coverage for r in strips], _MATERIAL, "all frames"),
    ):
        axis.plot(edges, np.repeat(np.array(values) * 100, 2), color=color, linewidth=1.8, label=name)
    axis.set(xlabel="belt coordinate s, mm", ylabel="measured, %", ylim=(0, 102))
    axis.grid(color="#e9ecef")
    axis.legend(frameon=False, fontsize=8, loc="lower left", ncols=2)
    return to_png(figure)


def _key() -> Table:
    meaning = {
        "measured": "seen well, and where the belt was is known",
        "degraded": "much of it hidden, or the belt's position continued at its last known speed",
        "bridged": "part of it passed between frames, interpolated between its neighbours",
        "missing": "not counted, or counted with the next frame's strip",
    }
    names = {"measured": "green", "degraded": "orange", "bridged": "blue", "missing": "red"}
    return Table(["quality", "colour", "means"], [[name, names[name], meaning[name]] for name in QUALITIES])


def _fusion_table(flow: FlowReport) -> Table:
    fusion = flow.document["fusion"]

    def percent(value: float) -> str:
        return f"{100 * value:.2f} %"

    return Table(
        ["", "one frame", "fused"],
        [
            ["measured", percent(fusion["single_coverage"]), percent(fusion["coverage"])],
            ["not measured", percent(1 - fusion["single_coverage"]), percent(1 - fusion["coverage"])],
            [
                "noise, where frames agree",
                f"{fusion['single_noise_mm']:.3f} mm",
                f"{fusion['fused_noise_mm']:.3f} mm",
            ],
            ["left out as gross errors", percent(fusion["left_out"]), ""],
        ],
    )


def _strip_table(records: Sequence[FlowRecord]) -> Table:
    shown = records[:_MOST_ROWS]
    rows = [
        [
            r.frame,
            "" if r.time_ns is None else f"{r.time_ns * 1e-9:.3f}",
            f"{r.belt_position_mm:.1f}",
            f"{r.strip_mm[0]:.1f} … {r.strip_mm[1]:.1f}",
            f"{r.volume_mm3 * 1e-6:.4f}",
            f"{r.sigma_mm3 * 1e-6:.4f}",
            f"{r.volume_flow_m3_h:.2f}",
            f"{r.coverage:.1%}",
            r.quality,
        ]
        for r in shown
    ]
    more = f"{len(records) - _MOST_ROWS} more are in flow.csv" if len(records) > _MOST_ROWS else ""
    columns = ["frame", "s", "position mm", "strip mm", "volume l", "σ l", "m³/h", "measured", "quality"]
    return Table(columns, rows, more)
