"""The chart of a comparison: both flows, and their difference with its band of ±2 σ."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from beltscape.report.drawing.charts import Chart, Entry, Key
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.plots import Form, make_panels
from beltscape.reprocessing.comparison.intervals import Intervals
from beltscape.reprocessing.comparison.ledger import Numbers
from beltscape.reprocessing.comparison.presentation.texts import has_epoch
from beltscape.reprocessing.comparison.uncertainty import COVERAGE_FACTOR

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
        Entry("A", "first"),
        Entry("B", "second", "dashed"),
        Entry("B - A", "third"),
        Entry("its ±2 σ", "band", "area"),
        Entry("beyond ±2 σ", "missing", "circle"),
    ]
    quantity = "flow" if has_flow(intervals) else "cross-section"
    caption = (
        f"Mean {quantity} of both on the belt that both measured, and the difference with ±2 σ, per interval."
    )
    return Chart.draw(partial(_plot, intervals), caption, Key(entries))


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
