"""The page of a comparison: verdict, totals, flow over time with its chart, where and why both differ.

The chart shows both flows, and their difference with its band of ±2 σ.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from beltscape.report.drawing.charts import Chart, ChartKey, KeyEntry
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.plots import Form, make_panels
from beltscape.report.page import Lines, Section, Table, Tile, Tiles, render
from beltscape.reprocessing.comparison.comparison import Comparison, PairedTotal
from beltscape.reprocessing.comparison.ledger import Numbers
from beltscape.reprocessing.comparison.texts import (
    choose_volume_unit,
    compare_with_totals,
    describe_alignment,
    describe_change,
    describe_reasons,
    describe_sides,
    explain_causes,
    explain_sigma,
    format_relative,
    format_time,
    format_with_sigma,
    has_epoch,
    list_differing,
    list_warnings,
    make_verdict,
)
from beltscape.reprocessing.comparison.uncertainty import COVERAGE_FACTOR, Intervals

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_S, _MIN, _H = 1e9, 60e9, 3600e9
"""Nanoseconds of a second, a minute and an hour."""
_LONG = 10.0
"""An axis counts in a unit of which it has more than this many. Chosen."""
_TICKS, _NARROW_TICKS = 9, 4
"""Most times on the axis of a wide and of a narrow chart."""
_STEPS_S = (1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200,
            *(86400 * days for days in (1, 2, 7, 14, 28, 91, 182, 364)))  # fmt: skip
"""Distances of these in seconds."""


def make_flow_chart(intervals: Intervals) -> Chart:
    """Return the chart: flows over time, or cross-sections along the belt where no speed is known."""
    entries = [
        KeyEntry("A", "first"),
        KeyEntry("B", "second", "dashed"),
        KeyEntry("B - A", "third"),
        KeyEntry("its ±2 σ", "band", "area"),
        KeyEntry("beyond ±2 σ", "missing", "circle"),
    ]
    quantity = "flow" if has_flow(intervals) else "cross-section"
    caption = (
        f"Mean {quantity} of both on the belt that both measured, and the difference with ±2 σ, per interval."
    )
    return Chart.draw(partial(_plot, intervals), caption, ChartKey(entries))


def has_flow(intervals: Intervals) -> bool:
    """Return whether the flow is known in every interval with belt."""
    return bool(np.isfinite(intervals.seconds[intervals.volume.length_mm > 0]).all())


def _plot(intervals: Intervals, form: Form) -> Figure:
    figure, (above, below) = make_panels(2, form, height=220, narrow_height=190)
    edges, label = _make_axis(intervals)
    scale, unit = _choose_quantity(intervals)
    first, second = intervals.volume.value * scale
    above.stairs(first, edges, baseline=None, color=light("first"), linewidth=1.6)
    above.stairs(second, edges, baseline=None, color=light("second"), linewidth=1.4, linestyle="--")
    above.set(ylabel=unit)
    above.set_ylim(bottom=min(0.0, float(np.nanmin(intervals.volume.value * scale))))
    _plot_difference(below, edges, intervals, scale)
    below.set(xlabel=label, ylabel=f"B - A, {unit.rpartition(', ')[2]}")
    for axis in (above, below):
        axis.set_xlim(edges[0], edges[-1])
        axis.grid()
        if has_dates(intervals):
            ticks = _list_ticks(edges, _NARROW_TICKS if form.narrow else _TICKS)
            axis.set_xticks([at for at, _ in ticks], [text for _, text in ticks])
    return figure


def _plot_difference(axis: Axes, edges: Numbers, intervals: Intervals, scale: Numbers) -> None:
    volume = intervals.volume
    difference, sigma = volume.difference * scale, volume.difference_sigma * scale
    low, high = difference - COVERAGE_FACTOR * sigma, difference + COVERAGE_FACTOR * sigma
    axis.fill_between(edges, *(np.append(each, each[-1]) for each in (low, high)),
                      step="post", color=light("band"), linewidth=0)  # fmt: skip
    axis.axhline(0, color=light("reference"), linewidth=0.8)
    axis.stairs(difference, edges, baseline=None, color=light("third"), linewidth=1.4)
    beyond = (volume.length_mm > 0) & ~volume.agrees & np.isfinite(sigma)
    middle = 0.5 * (edges[1:] + edges[:-1])
    axis.plot(middle[beyond], difference[beyond], "o", color=light("missing"), markersize=2.4)


def _choose_quantity(intervals: Intervals) -> tuple[Numbers, str]:
    """Return the factor from an interval's volume to what is plotted, and its name with the unit."""
    if has_flow(intervals):
        return 3600e-9 / intervals.seconds, "flow, m³/h"
    length = intervals.volume.length_mm
    return np.divide(0.01, length, out=np.full(len(length), np.nan), where=length > 0), "section, cm²"


def has_dates(intervals: Intervals) -> bool:
    """Return whether the axis shows dates."""
    return intervals.axis == "time" and has_epoch(int(intervals.start[0]))


def _make_axis(intervals: Intervals) -> tuple[Numbers, str]:
    """Return the (n + 1,) edges of the intervals on the axis, and its label."""
    edges = np.append(intervals.start, intervals.start[-1] + intervals.width)
    if intervals.axis == "belt":
        return edges / 1000, "belt, m"
    if has_dates(intervals):
        return edges / _S, f"UTC, from {datetime.fromtimestamp(float(edges[0]) / _S, UTC):%Y-%m-%d %H:%M}"
    since = (edges - edges[0]).astype(np.float64)
    unit, name = next(
        ((unit, name) for unit, name in ((_H, "h"), (_MIN, "min")) if since[-1] > _LONG * unit), (_S, "s")
    )
    return since / unit, f"time since the first frame, {name}"


def _list_ticks(edges: Numbers, count: int) -> list[tuple[float, str]]:
    """Return round instants, s since 1970, at most ``count``, with their texts: times of day, or days."""
    low, high = float(edges[0]), float(edges[-1])
    step = next((each for each in _STEPS_S if (high - low) / each <= count), _STEPS_S[-1])
    form = "%d %b" if step >= 86400 else "%H:%M" if step >= 60 else "%H:%M:%S"
    instants = np.arange(np.ceil(low / step) * step, high + 1e-6, step)
    return [(at, datetime.fromtimestamp(at, UTC).strftime(form)) for at in instants.tolist()]


def render_comparison(comparison: Comparison, *, warnings: Sequence[str] = ()) -> str:
    """Return report.html as one self-contained page."""
    totals = [
        Tiles(list(_list_tiles(comparison))),
        _make_totals_table(comparison),
        _make_ledgers_table(comparison),
    ]
    causes = [line[:1].upper() + line[1:] + "." for line in explain_causes(comparison)]
    sections = [
        Section("Totals", f"A is {comparison.first.folder}, B is {comparison.second.folder}.", totals),
        Section("Flow", "", [make_flow_chart(comparison.intervals)]),
        Section("Why", "What both were measured by, from the provenance of their runs.", [Lines(causes)]),
        *_list_places(comparison),
        Section("Uncertainty and alignment", "", [Lines(list(_list_notes(comparison)))]),
    ]
    return render(
        "Comparison of two histories",
        make_verdict(comparison),
        sections,
        warnings=[*list_warnings(comparison), *warnings],
    )


def _list_tiles(comparison: Comparison) -> Iterator[Tile]:
    unit, factor = choose_volume_unit(comparison)
    volume, intervals = comparison.volume, comparison.intervals.volume
    filled = intervals.length_mm > 0
    value, _, sigma = format_with_sigma(
        volume.difference * factor, volume.difference_sigma * factor, sign="+"
    ).partition(" ± ")
    share, _, share_sigma = format_relative(volume).removesuffix(" %").partition(" ± ")
    beyond = int(np.count_nonzero(filled & ~intervals.agrees))
    yield Tile("B - A", value, unit, f"σ {sigma} {unit}")
    yield Tile("relative", share, "%", f"σ {share_sigma} %")
    yield Tile(
        "compared",
        f"{comparison.compared_mm / 1000:.1f}",
        "m",
        f"{comparison.alignment.shared_frames} shared frames",
    )
    yield Tile("beyond 2 σ", f"{beyond}", f"of {int(filled.sum())}", "intervals")


def _make_totals_table(comparison: Comparison) -> Table:
    unit, factor = choose_volume_unit(comparison)
    rows = [_make_total_row(f"volume, {unit}", comparison.volume, factor)]
    if comparison.mass is not None:
        rows.append(_make_total_row("mass, t", comparison.mass, 1e-3))
    return Table(["on the belt of both", "A", "B", "B - A", ""], rows)


def _make_ledgers_table(comparison: Comparison) -> Table:
    unit, factor = choose_volume_unit(comparison)
    rows = [
        [
            name,
            f"{whole.records}",
            f"{whole.length_mm / 1000:.2f}",
            f"{whole.missing_mm / 1000:.2f}",
            f"{whole.volume_mm3 * factor:.6g}",
            f"{whole.alone_mm / 1000:.2f}",
            f"{whole.alone_mm3 * factor:.4g}",
        ]
        for name, whole in zip("AB", comparison.wholes, strict=True)
    ]
    columns = [
        "whole ledger",
        "records",
        "belt, m",
        "not measured, m",
        f"volume, {unit}",
        "only here, m",
        f"{unit}",
    ]
    return Table(columns, rows)


def _make_total_row(name: str, total: PairedTotal, factor: float) -> list[str | KeyEntry]:
    mark = {
        True: KeyEntry("agrees", "measured", "circle"),
        False: KeyEntry("differs", "missing", "cross"),
        None: KeyEntry("no σ", "degraded", "square"),
    }[total.agrees]
    return [
        name,
        format_with_sigma(total.first * factor, total.first_sigma * factor),
        format_with_sigma(total.second * factor, total.second_sigma * factor),
        format_with_sigma(total.difference * factor, total.difference_sigma * factor, sign="+"),
        mark,
    ]


def _list_places(comparison: Comparison) -> Iterator[Section]:
    if comparison.changes:
        intro = "Belt that both ledgers count in another way, or that only one has."
        yield Section("Changed standings", intro, [_make_changes_table(comparison)])
    if comparison.stretches:
        intro = (
            "Stretches on which every strip differs beyond 2 σ in the same direction, at most an interval long; what "
            "exceeds 2 σ most comes first."
        )
        yield Section("Largest differences", intro, [_make_stretches_table(comparison)])


def _make_changes_table(comparison: Comparison) -> Table:
    unit, factor = choose_volume_unit(comparison)
    rows = [
        [
            describe_change(part),
            f"{part.length_mm / 1000:.2f}",
            f"{part.stretches}",
            f"{part.volume_mm3 * factor:.4g}",
            _format_belt(part.longest_mm),
            describe_reasons(part) or "neither ledger gives a reason for it",
        ]
        for part in comparison.changes
    ]
    return Table(["A → B", "m", "stretches", f"only one, {unit}", "the longest, m", "reasons"], rows)


def _make_stretches_table(comparison: Comparison) -> Table:
    unit, factor = choose_volume_unit(comparison)
    rows = [
        [
            _format_belt((one.from_mm, one.to_mm)),
            format_time(one.time_ns),
            f"{one.first.volume_mm3 * factor:.4g}",
            f"{one.second.volume_mm3 * factor:.4g}",
            format_with_sigma(one.difference_mm3 * factor, one.sigma_mm3 * factor, sign="+"),
            describe_sides(one),
        ]
        for one in comparison.stretches
    ]
    columns = ["belt of A, m", "time", f"A, {unit}", f"B, {unit}", f"B - A, {unit}", "frames and standing"]
    return Table(columns, rows)


def _format_belt(belt_mm: tuple[float, float]) -> str:
    return f"{belt_mm[0] / 1000:.2f} … {belt_mm[1] / 1000:.2f}"


def _list_notes(comparison: Comparison) -> Iterator[str]:
    yield explain_sigma(comparison)
    if text := compare_with_totals(comparison):
        yield text
    yield f"Aligned by {describe_alignment(comparison)}."
    yield "The load of a strip that is compared in part is taken as uniform; σ has the error of that (GUM 4.3.7)."
    if comparison.differing:
        yield f"Values that are not identical (records): {list_differing(comparison)}."
