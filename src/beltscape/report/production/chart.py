"""The chart of a report: mean flow over local time, in the colours of the products."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from beltscape.report.drawing.charts import Chart, Entry, Key
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.plots import Form, make_panels
from beltscape.report.production.document import ReportDocument
from beltscape.report.production.texts import Texts

_TICKS, _NARROW_TICKS = 9, 4
"""Most times on the axis of a wide and of a narrow chart."""
_STEPS_MIN = (1, 2, 5, 10, 15, 30, 60, 120, 180, 240, 360, 720, 1440)
"""Distances of these, minutes."""


def make_flow_chart(document: ReportDocument, texts: Texts) -> Chart:
    """Return the chart; intervals without a measurement have no bar."""
    caption = texts("flow_caption")
    known = [name for name in document.colours if any(c.product == name for c in document.changes)]
    entries = [Entry(name, document.colours[name], "square") for name in known]
    return Chart.draw(partial(_plot, document, texts), caption, *([Key(entries)] if entries else []))


def _plot(document: ReportDocument, texts: Texts, form: Form) -> Figure:
    figure, (axis,) = make_panels(1, form, height=220, narrow_height=190)
    flow, period = document.flow, document.period
    colours = [_find_colour(document, at_ms + flow.width_ms // 2) for at_ms in flow.start_ms]
    values = np.array([np.nan if value is None else value for value in flow.m3_h], np.float64)
    axis.bar(flow.start_ms, values, width=flow.width_ms, align="edge", color=colours, linewidth=0)
    axis.set(xlim=(period.since_ms, period.until_ms), ylabel=texts("flow_axis"))
    axis.set_xlabel(texts("time_axis", zone=document.time_zone))
    ticks = _list_ticks(period.since_ms, period.until_ms, _NARROW_TICKS if form.narrow else _TICKS)
    axis.set_xticks(ticks, [texts.clock(at_ms) for at_ms in ticks])
    axis.set_ylim(bottom=min(0.0, float(np.nanmin(values, initial=0.0))))
    axis.grid(axis="y")
    return figure


def _find_colour(document: ReportDocument, at_ms: int) -> str:
    """Return the colour of the product at an instant."""
    before = [change for change in document.changes if change.at_ms <= at_ms]
    name = before[-1].product if before else ""
    return document.colours.get(name, light("first"))


def _list_ticks(since_ms: int, until_ms: int, count: int) -> Sequence[int]:
    """Return round instants between both, at most ``count``, counted from the begin."""
    span_min = (until_ms - since_ms) / 60_000
    step = next((each for each in _STEPS_MIN if span_min / each <= count), 1440)
    return range(since_ms, until_ms + 1, step * 60_000)
