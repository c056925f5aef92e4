"""The report page of a moving belt: total flow with uncertainty, the fused belt, and the strips.

Its charts show the belt from above, flow, motion, and coverage.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from beltscape.core.height_map import HeightMap
from beltscape.core.ledger import QUALITIES, FlowRecord
from beltscape.measure.flow.meter import FramePlacement
from beltscape.measure.flow.strips import FlowTotals
from beltscape.report.drawing.charts import Chart, ChartKey, KeyEntry, Mark
from beltscape.report.drawing.legend import HEIGHT, Scale
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.pictures import quantile_range
from beltscape.report.drawing.plots import Form, fade_unmeasured, make_panels, show_map
from beltscape.report.page import Section, Table, Tile, Tiles, render

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_SHAPES: Mapping[str, tuple[Mark, str]] = {
    "measured": ("circle", "o"), "degraded": ("square", "s"), "bridged": ("triangle", "^"), "missing": ("cross", "X"),
}  # fmt: skip
"""Quality → mark in a key and in a plot; the colour is the palette's role of the same name."""
_STRIP = "#c9d3df"
"""Colour of the lines between strips, drawn on the map's colours."""
_ROW_MM = 3000.0
"""Length of the pieces in which a long belt is drawn below one another; a third of it on a phone."""
_MOST_PIECES = 12
"""Largest number of these pieces; a longer belt has longer ones."""
_MOST_CELLS = 1600
"""Largest number of cells of a piece along the belt."""


def make_state_entry(quality: str) -> KeyEntry:
    """Return the word of a strip's quality with its mark."""
    return KeyEntry(quality, quality, _SHAPES[quality][0])


def make_belt_chart(records: Sequence[FlowRecord], belt: HeightMap, share: NDArray[np.float64]) -> Chart:
    """Return the fused belt, seen from above, travelling to the left."""
    low, high = quantile_range(belt.height_mm, 0.002)
    scale = Scale(min(low, 0.0), max(high, 1.0), HEIGHT, label="load, mm")
    caption = (
        "Fused surface over the belt coordinate s; lines part the strips, faded places are interpolated."
    )
    return Chart.draw(partial(_plot_belt, records, belt, share, scale), caption, scale)


def _plot_belt(
    records: Sequence[FlowRecord], belt: HeightMap, share: NDArray[np.float64], scale: Scale, form: Form
) -> Figure:
    half = belt.cell_mm / 2
    low, high = belt.y_mm[0] - half, belt.y_mm[-1] + half
    row_mm = _ROW_MM / 3 if form.narrow else _ROW_MM
    count = int(np.clip(np.ceil((high - low) / row_mm), 1, _MOST_PIECES))
    across = (belt.x_mm[0] - half, belt.x_mm[-1] + half)
    height = float(np.clip((form.width - 70) * (across[1] - across[0]) * count / (high - low), 70, 400)) + 40
    figure, axes = make_panels(count, form, height=height)
    every = max(1, round(len(belt.y_mm) / count / _MOST_CELLS))
    for axis, rows in zip(axes, np.array_split(np.arange(len(belt.y_mm)), count), strict=True):
        heights = belt.height_mm[rows]
        colors = fade_unmeasured(scale.to_rgb(heights), heights, share[rows]).transpose(1, 0, 2)[
            ::every, ::every
        ]
        start, end = float(belt.y_mm[rows[0]] - half), float(belt.y_mm[rows[-1]] + half)
        show_map(axis, colors, (start, end, *across))
        for record in records:
            if start < record.strip_mm[1] < end:
                axis.axvline(record.strip_mm[1], color=_STRIP, linewidth=0.7)
        axis.set(xlim=(start, end), ylabel="x, mm")
    axes[-1].set_xlabel("belt coordinate s, mm")
    return figure


def make_flow_chart(records: Sequence[FlowRecord]) -> Chart:
    """Return the cross-section over the belt, and the flow over time."""
    present = [quality for quality in QUALITIES if any(r.quality == quality for r in records)]
    caption = "Cross-section along the belt with two σ, and flow over time."
    return Chart.draw(
        partial(plot_flow, records), caption, ChartKey([make_state_entry(name) for name in present])
    )


def plot_flow(records: Sequence[FlowRecord], form: Form) -> Figure:
    """Plot the cross-section along the belt and, with times, the flow."""
    timed = [r for r in records if r.time_ns is not None and np.isfinite(r.volume_flow_m3_h)]
    figure, axes = make_panels(2 if timed else 1, form, height=210, narrow_height=190)
    _plot_cross_sections(axes[0], records)
    if timed:
        _plot_rates(axes[1], timed)
    for axis in axes:
        axis.grid()
    return figure


def _plot_cross_sections(axis: Axes, records: Sequence[FlowRecord]) -> None:
    for record in _strips(records):
        length = record.strip_mm[1] - record.strip_mm[0]
        area, sigma = record.area_mm2 / 100, record.sigma_mm3 / length / 100
        color = light(record.quality)
        axis.fill_between(record.strip_mm, 0, area, color=color, alpha=0.25, linewidth=0)
        axis.plot(record.strip_mm, [area, area], color=color, linewidth=1.8)
        band = (area - 2 * sigma, area + 2 * sigma)
        axis.fill_between(record.strip_mm, *band, color=color, alpha=0.35, linewidth=0)
        axis.plot(np.mean(record.strip_mm), area, _SHAPES[record.quality][1], color=color, markersize=4.5)
    axis.set(xlabel="belt coordinate s, mm", ylabel="cross-section, cm²")


def _plot_rates(axis: Axes, timed: Sequence[FlowRecord]) -> None:
    time, rate = _times(timed), np.array([r.volume_flow_m3_h for r in timed])
    axis.plot(time, rate, color=light("reference"), linewidth=1.0, zorder=1)
    for quality, (_, marker) in _SHAPES.items():
        here = np.array([r.quality == quality for r in timed])
        if here.any():
            axis.plot(time[here], rate[here], marker, color=light(quality), markersize=5.5, zorder=2)
    axis.set(xlabel="time, s", ylabel="flow, m³/h")
    axis.set_ylim(bottom=min(0.0, float(rate.min())))
    densities = {record.density_kg_m3 for record in timed}
    if len(densities) == 1 and np.isfinite([r.mass_flow_t_h for r in timed]).all():
        factor = densities.pop() * 1e-3  # one density holds for all: mass flow on the right
        back = (partial(np.multiply, factor), partial(np.multiply, 1 / factor))
        axis.secondary_yaxis("right", functions=back).set_ylabel("t/h")


def make_motion_chart(steps: Sequence[FramePlacement]) -> Chart:
    """Return the speed of material and encoder, and the difference of their positions."""
    entries = [KeyEntry("belt as used", "first"), KeyEntry("told by the material", "first", "circle")]
    if any(s.place.encoder_mm is not None for s in steps):
        entries.append(KeyEntry("encoder", "second", "dashed"))
    caption = "Speed by the material and by the encoder; what they differ by."
    return Chart.draw(partial(_plot_motion, steps), caption, ChartKey(entries))


def _plot_motion(steps: Sequence[FramePlacement], form: Form) -> Figure:
    both = [s for s in steps if s.place.encoder_mm is not None]
    figure, axes = make_panels(2 if both else 1, form, height=190, narrow_height=180)
    if len(steps) > 1:
        _plot_speeds(axes[0], steps, encoder=len(both) == len(steps))
    axes[0].set(xlabel="time, s", ylabel="speed, mm/s")
    if both:
        off = [float(s.place.encoder_mm or 0.0) - s.place.position_mm for s in both]
        axes[1].plot([s.place.clock for s in both], off, "--", color=light("second"), linewidth=1.4)
        axes[1].axhline(0, color=light("reference"), linewidth=0.8)
        axes[1].set(xlabel="time, s", ylabel="encoder − material, mm")
    for axis in axes:
        axis.grid()
    return figure


def _plot_speeds(axis: Axes, steps: Sequence[FramePlacement], *, encoder: bool) -> None:
    clock = np.array([s.place.clock for s in steps])
    place = np.array([s.place.position_mm for s in steps])
    measured = np.array([s.place.source == "material" for s in steps], bool)[1:]
    middle = 0.5 * (clock[1:] + clock[:-1])
    with np.errstate(divide="ignore", invalid="ignore"):
        speed = np.diff(place) / np.diff(clock)
        axis.plot(middle, speed, color=light("first"), linewidth=1.3)
        axis.plot(middle[measured], speed[measured], "o", color=light("first"), markersize=4.5)
        if encoder:
            encoder_speed = np.diff(np.array([s.place.encoder_mm for s in steps], np.float64)) / np.diff(
                clock
            )
            axis.plot(middle, encoder_speed, "--", color=light("second"), linewidth=1.3)
    low, high = axis.get_ylim()
    room = max(
        0.0, 0.01 * abs(0.5 * (low + high)) - 0.5 * (high - low)
    )  # small variations of the speed are not magnified
    axis.set_ylim(low - room, high + room)


def make_coverage_chart(records: Sequence[FlowRecord]) -> Chart:
    """Return the measured share of every strip, by a single frame and by all frames."""
    key = ChartKey([KeyEntry("all frames", "first"), KeyEntry("one frame alone", "second", "dashed")])
    return Chart.draw(partial(_plot_coverage, records), "Share of each strip that was measured.", key)


def _plot_coverage(records: Sequence[FlowRecord], form: Form) -> Figure:
    figure, (axis,) = make_panels(1, form, height=190, narrow_height=170)
    strips = _strips(records)
    edges = [s for record in strips for s in record.strip_mm]
    for values, role, style in (
        ([r.single_coverage for r in strips], "second", "--"),
        ([r.coverage for r in strips], "first", "-"),
    ):
        axis.plot(edges, np.repeat(np.array(values) * 100, 2), style, color=light(role), linewidth=1.8)
    axis.set(xlabel="belt coordinate s, mm", ylabel="measured, %", ylim=(0, 102))
    axis.grid()
    return figure


def _strips(records: Sequence[FlowRecord]) -> list[FlowRecord]:
    return [r for r in records if r.strip_mm[1] > r.strip_mm[0]]


def _times(records: Sequence[FlowRecord]) -> NDArray[np.float64]:
    return np.array([(r.time_ns or 0) * 1e-9 for r in records])


_MOST_ROWS = 400
"""Largest number of rows of the table; flow.csv has all."""


@dataclass(frozen=True, slots=True, eq=False)
class FlowReport:
    """The contents of the page."""

    records: Sequence[FlowRecord]
    steps: Sequence[FramePlacement]
    totals: FlowTotals
    document: Mapping[str, Any]
    """The figures of flow.json."""
    belt: HeightMap
    """The fused belt, columns x, rows s."""
    share: NDArray[np.float64]
    """Share of its cells that were measured."""


def render_flow_page(flow: FlowReport, *, warnings: Sequence[str]) -> str:
    """Return report.html of a moving belt."""
    sections = [
        Section("What passed", "", [Tiles(_tiles(flow))]),
        Section(
            "The belt",
            "All frames laid over one another where the belt had moved to: load above the empty belt. It travels to "
            "the left.",
            [make_belt_chart(flow.records, flow.belt, flow.share)],
        ),
        Section(
            "Flow",
            "Every record is the strip of belt that became new in its frame; the strips meet without gap or overlap, "
            "so their volumes add up to the total.",
            [make_flow_chart(flow.records), _key()],
        ),
        Section(
            "The belt's motion",
            "Found by laying successive height maps over one another; the projected pattern stands still and cannot "
            "tell it.",
            [make_motion_chart(flow.steps)],
        ),
        Section(
            "What fusion adds",
            "The material meets other dots, markers and shadows in every frame.",
            [make_coverage_chart(flow.records), _fusion_table(flow)],
        ),
        Section("Strips", "", [_strip_table(flow.records)]),
    ]
    return render("Flow on the belt", summarise_flow(flow), sections, warnings=warnings)


def summarise_flow(flow: FlowReport) -> str:
    """Return the result in a sentence."""
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
            Tile(
                "belt speed",
                f"{np.median(speeds) / 1000:.3f}",
                "m/s",
                f"towards {document['direction'] or '?'}",
            )
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


def _key() -> Table:
    meaning = {
        "measured": "seen well, and where the belt was is known",
        "degraded": "much of it hidden, or the belt's position continued at its last known speed",
        "bridged": "part of it passed between frames, interpolated between its neighbours",
        "missing": "not counted, or counted with the next frame's strip",
    }
    return Table(["quality", "means"], [[make_state_entry(name), meaning[name]] for name in QUALITIES])


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
            make_state_entry(r.quality),
        ]
        for r in shown
    ]
    more = f"{len(records) - _MOST_ROWS} more are in flow.csv" if len(records) > _MOST_ROWS else ""
    columns = ["frame", "s", "position mm", "strip mm", "volume l", "σ l", "m³/h", "measured", "quality"]
    return Table(columns, rows, more)
