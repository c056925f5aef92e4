"""The page of a report: totals with σ, products, flow, shifts, batches, changes and the belt scale.

The chart shows the mean flow over local time, in the colours of the products.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from beltscape.report.drawing.charts import Chart, ChartKey, KeyEntry
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.plots import Form, make_panels, use_decimal_mark
from beltscape.report.page import Lines, Section, Table, Tile, Tiles, render
from beltscape.report.production.document import BatchOut, PeriodOut, ReportDocument, ScaleOut, SumsOut
from beltscape.report.production.texts import Texts, make_title, open_texts, summarise

_TICKS, _NARROW_TICKS = 9, 4
"""Most times on the axis of a wide and of a narrow chart."""
_STEPS_MIN = (1, 2, 5, 10, 15, 30, 60, 120, 180, 240, 360, 720, 1440)
"""Distances of these, minutes."""


def make_flow_chart(document: ReportDocument, texts: Texts) -> Chart:
    """Return the chart; intervals without a measurement have no bar."""
    caption = texts("flow_caption")
    known = [name for name in document.colours if any(c.product == name for c in document.changes)]
    entries = [KeyEntry(name, document.colours[name], "square") for name in known]
    return Chart.draw(partial(_plot, document, texts), caption, *([ChartKey(entries)] if entries else []))


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
    use_decimal_mark([axis], texts("decimal"))
    return figure


def _find_colour(document: ReportDocument, at_ms: int) -> str:
    """Return the colour of the product at an instant."""
    before = [change for change in document.changes if change.at_ms <= at_ms]
    name = before[-1].product if before else ""
    return document.colours.get(name, light("first"))


def _list_ticks(since_ms: int, until_ms: int, count: int) -> Sequence[int]:
    """Return round instants between both, at most ``count``, counted from the beginning."""
    span_min = (until_ms - since_ms) / 60_000
    step = next((each for each in _STEPS_MIN if span_min / each <= count), 1440)
    return range(since_ms, until_ms + 1, step * 60_000)


def render_report(document: ReportDocument) -> str:
    """Return the report as one self-contained HTML page."""
    texts = open_texts(document.language, document.time_zone)
    sections = [
        Section(texts("totals"), texts("sigma_note"), [Tiles(_tiles(document.period.totals, texts))]),
        Section(texts("products"), "", [_product_table(document, texts)]),
        Section(texts("flow"), "", [make_flow_chart(document, texts)]),
    ]
    if document.shifts:
        sections.append(Section(texts("shifts"), "", [_shift_table(document.shifts, texts)]))
    sections.append(Section(texts("batches"), "", [_batch_table(document.batches, texts)]))
    if document.changes:
        sections.append(Section(texts("changes"), "", [_change_table(document, texts)]))
    weighed = list(_list_weighings(document, texts))
    if weighed:
        sections.append(Section(texts("scale"), texts("scale_intro"), [_scale_table(weighed, texts)]))
    footer = texts("footer", made=texts.moment(document.made_ms), zone=document.time_zone)
    sections.append(Section("", footer, []))
    return render(
        make_title(document), summarise(document), sections, warnings=list(_list_warnings(document, texts)),
        language=document.language, warnings_title=texts("warnings"),
    )  # fmt: skip


def _tiles(totals: SumsOut, texts: Texts) -> list[Tile]:
    length = totals.valid_m + totals.degraded_m + totals.missing_m

    def share(part: float) -> str:
        return f"{texts.number(100 * part / length, 1)} %" if length > 0 else ""

    def quantity(key: str, value: float | None, sigma: float | None, unit: str) -> Tile:
        number, _, rest = texts.with_sigma(value, sigma).partition(" ± ")
        return Tile(texts(key), number, unit, f"± {rest}" if rest else "")

    return [
        quantity("volume", totals.volume_m3, totals.sigma_m3, "m³"),
        quantity("mass_label", totals.mass_t, totals.mass_sigma_t, "t"),
        Tile(texts("belt"), texts.number(length, 0), "m"),
        Tile(texts("valid"), texts.number(totals.valid_m, 0), "m", share(totals.valid_m)),
        Tile(texts("missing"), texts.number(totals.missing_m, 0), "m", share(totals.missing_m)),
    ]


def _sum_cells(totals: SumsOut, texts: Texts) -> list[str]:
    length = totals.valid_m + totals.degraded_m + totals.missing_m
    return [
        texts.with_sigma(totals.volume_m3, totals.sigma_m3),
        texts.with_sigma(totals.mass_t, totals.mass_sigma_t),
        texts.number(length, 1),
        texts.number(totals.missing_m, 1),
    ]


def _sum_columns(texts: Texts) -> list[str]:
    return [texts(key) for key in ("volume_m3", "mass_t", "belt_m", "missing_m")]


def _mark_product(name: str, document: ReportDocument, texts: Texts) -> KeyEntry | str:
    colour = document.colours.get(name)
    return (name or texts("no_product")) if colour is None else KeyEntry(name, colour, "square")


def _product_table(document: ReportDocument, texts: Texts) -> Table:
    rows: list[Sequence[str | KeyEntry]] = [
        [_mark_product(one.product, document, texts), *_sum_cells(one.totals, texts)]
        for one in document.period.by_product
    ]
    return Table([texts("product"), *_sum_columns(texts)], rows)


def _shift_table(shifts: Sequence[PeriodOut], texts: Texts) -> Table:
    rows = [
        [
            shift.name,
            texts.clock(shift.since_ms),
            texts.clock(shift.until_ms),
            *_sum_cells(shift.totals, texts),
        ]
        for shift in shifts
    ]
    return Table([texts("shift"), texts("from"), texts("until"), *_sum_columns(texts)], rows)


def _batch_table(batches: Sequence[BatchOut], texts: Texts) -> Table | Lines:
    if not batches:
        return Lines([texts("no_batches")])
    rows = [
        [
            batch.name,
            texts.moment(batch.started_ms),
            texts("open") if batch.ended_ms is None else texts.moment(batch.ended_ms),
            ", ".join(one.product for one in batch.by_product if one.product) or "–",
            *_sum_cells(batch.totals, texts),
        ]
        for batch in batches
    ]
    columns = [texts(key) for key in ("batch", "started", "stopped", "product")]
    return Table([*columns, *_sum_columns(texts)], rows)


def _change_table(document: ReportDocument, texts: Texts) -> Table:
    rows: list[Sequence[str | KeyEntry]] = [
        [_mark_product(change.product, document, texts), texts.moment(change.at_ms), change.by]
        for change in document.changes
    ]
    return Table([texts("product"), texts("at"), texts("by")], rows)


def _list_weighings(document: ReportDocument, texts: Texts) -> Iterator[tuple[str, ScaleOut]]:
    if document.period.scale is not None:
        yield texts("period"), document.period.scale
    for each in (*document.shifts, *document.batches):
        if each.scale is not None:
            yield each.name, each.scale


def _scale_table(weighed: Sequence[tuple[str, ScaleOut]], texts: Texts) -> Table:
    rows = [
        [
            name,
            texts.with_sigma(scale.mass_t, scale.sigma_t),
            texts.with_sigma(scale.density_kg_m3, scale.sigma_kg_m3),
            texts.with_sigma(scale.moisture_percent, scale.moisture_sigma_percent),
            texts.with_sigma(scale.deviation_t, scale.deviation_sigma_t),
            KeyEntry(texts("disagrees"), "missing", "cross") if scale.disagrees else "",
        ]
        for name, scale in weighed
    ]
    columns = [texts(key) for key in ("what", "scale_mass", "density", "moisture", "deviation")]
    return Table([*columns, ""], rows)


def _list_warnings(document: ReportDocument, texts: Texts) -> Iterator[str]:
    totals, scale = document.period.totals, document.period.scale
    length = totals.valid_m + totals.degraded_m + totals.missing_m
    if not totals.records:
        yield texts("warning.nothing")
    if totals.missing_m > 0:
        share = texts.number(100 * totals.missing_m / length, 2)
        yield texts("warning.missing", length=texts.number(totals.missing_m, 1), share=share)
    if totals.degraded_m > 0:
        yield texts("warning.degraded", length=texts.number(totals.degraded_m, 1))
    if totals.mass_t is None:
        yield texts("warning.density")
    if scale is not None and scale.disagrees:
        yield texts("warning.scale", deviation=texts.with_sigma(scale.deviation_t, scale.deviation_sigma_t))
    for batch in document.batches:
        if batch.scale is not None and batch.scale.disagrees:
            deviation = texts.with_sigma(batch.scale.deviation_t, batch.scale.deviation_sigma_t)
            yield texts("warning.scale_batch", name=batch.name, deviation=deviation)
        if batch.ended_ms is not None and not batch.complete:
            yield texts("warning.open", name=batch.name)
