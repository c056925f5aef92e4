"""The picture of a re-processing over time: which worker measured when."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from matplotlib.figure import Figure

from beltscape.report.drawing.charts import Chart
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.plots import Form, make_panels
from beltscape.reprocessing.manifest import Measured

_MOST_WORKERS = 64
"""Largest number of rows; further workers are left out, and the caption says so."""


def make_timeline(measured: Sequence[Measured]) -> Chart:
    """Return the bars of all pieces by worker; pauses between runs are cut out."""
    workers = sorted({one.worker for one in measured})
    shown = workers[:_MOST_WORKERS]
    caption = f"{len(measured)} pieces on {len(workers)} workers (processes)"
    if len(shown) < len(workers):
        caption += f"; the first {len(shown)} are shown"
    return Chart.draw(partial(_plot, measured, shown), caption + ".")


def _plot(measured: Sequence[Measured], workers: Sequence[str], form: Form) -> Figure:
    figure, (axes,) = make_panels(1, form, height=60.0 + 16.0 * max(len(workers), 2))
    rows = {worker: row for row, worker in enumerate(workers)}
    starts = _cut_pauses(measured)
    bars = [
        (rows[one.worker], start_s, one.seconds)
        for one, start_s in zip(measured, starts, strict=True)
        if one.worker in rows
    ]
    at, begins, lengths = zip(*bars, strict=True) if bars else ((), (), ())
    axes.barh(at, lengths, left=begins, height=0.8, color=light("measured"), edgecolor="white")
    axes.set_yticks(range(len(workers)), [str(row + 1) for row in rows.values()])
    axes.set_ylim(len(workers) - 0.5, -0.5)
    axes.set_xlabel("time, s")
    axes.set_ylabel("worker")
    return figure


def _cut_pauses(measured: Sequence[Measured], longest_s: float = 60.0) -> list[float]:
    """Return the begins on a time axis without the pauses in which no worker measured, s from the first one."""
    order = sorted(range(len(measured)), key=lambda index: measured[index].begin_s)
    starts, cut, until = [0.0] * len(measured), 0.0, None
    for index in order:
        one = measured[index]
        until = one.begin_s if until is None else until
        if one.begin_s - until > longest_s:
            cut += one.begin_s - until
        starts[index] = one.begin_s - measured[order[0]].begin_s - cut
        until = max(until, one.begin_s + one.seconds)
    return starts
