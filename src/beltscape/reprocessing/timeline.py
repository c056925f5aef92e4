"""The picture of a re-processing over time: which worker measured when."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from matplotlib.figure import Figure

from beltscape.report.drawing.charts import Chart
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.plots import Form, make_panels
from beltscape.reprocessing.manifest import WorkSpan

_MOST_WORKERS = 64
"""Largest number of rows; further workers are left out, and the caption says so."""


def make_timeline(spans: Sequence[WorkSpan]) -> Chart:
    """Return the bars of all pieces by worker; pauses between runs are cut out."""
    workers = sorted({one.worker for one in spans})
    shown = workers[:_MOST_WORKERS]
    caption = f"{len(spans)} pieces on {len(workers)} workers (processes)"
    if len(shown) < len(workers):
        caption += f"; the first {len(shown)} are shown"
    return Chart.draw(partial(_plot, spans, shown), caption + ".")


def _plot(spans: Sequence[WorkSpan], workers: Sequence[str], form: Form) -> Figure:
    figure, (axes,) = make_panels(1, form, height=60.0 + 16.0 * max(len(workers), 2))
    rows = {worker: row for row, worker in enumerate(workers)}
    starts = _cut_pauses(spans)
    bars = [
        (rows[one.worker], start_s, one.seconds)
        for one, start_s in zip(spans, starts, strict=True)
        if one.worker in rows
    ]
    at, begins, lengths = zip(*bars, strict=True) if bars else ((), (), ())
    axes.barh(at, lengths, left=begins, height=0.8, color=light("measured"), edgecolor="white")
    axes.set_yticks(range(len(workers)), [str(row + 1) for row in rows.values()])
    axes.set_ylim(max(len(workers), 1) - 0.5, -0.5)
    axes.set_xlabel("time, s")
    axes.set_ylabel("worker")
    return figure


def _cut_pauses(spans: Sequence[WorkSpan], longest_s: float = 60.0) -> list[float]:
    """Return the begins on a time axis without the pauses in which no worker measured, s from the first one.

    ``spans`` are in the order of their begins.
    """
    starts: list[float] = []
    first = until = spans[0].begin_s if spans else 0.0
    cut = 0.0
    for one in spans:
        pause = one.begin_s - until
        cut += pause if pause > longest_s else 0.0
        starts.append(one.begin_s - first - cut)
        until = max(until, one.begin_s + one.seconds)
    return starts
