"""The report page of a re-processing: what passed, what could not be read, and where the time went.

Its picture over time shows which worker measured when.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from matplotlib.figure import Figure

from beltscape.report.drawing.charts import Chart
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.plots import Form, make_panels
from beltscape.report.page import Lines, Section, Table, Tile, Tiles, render
from beltscape.reprocessing.history import JoinedLedger
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
    return Chart.draw(partial(_plot_workers, spans, shown), caption + ".")


def _plot_workers(spans: Sequence[WorkSpan], workers: Sequence[str], form: Form) -> Figure:
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


_MOST_ROWS = 400
"""Largest number of rows of a table; reprocessing.json has all."""


def render_report(document: Mapping[str, Any], ledger: JoinedLedger, spans: Sequence[WorkSpan]) -> str:
    """Return report.html."""
    sections = [Section("What passed", "", [Tiles(_totals_tiles(document))])]
    problems = [(one["name"], one["reason"]) for one in document["unreadable"]]
    problems += [(one["piece"], one["reason"]) for one in document["failed"]]
    problems += [
        (one["recording"], f"begins {one['difference_mm']:+.1f} mm from the end of the piece before")
        for one in document["seams"]
    ]
    if problems:
        sections.append(
            Section(
                "What could not be measured",
                "The belt of a piece that was not measured is in the ledger as missing; the next run tries it again.",
                [_table(["recording", "why"], problems)],
            )
        )
    sections.append(
        Section(
            "Where the time went",
            "Every bar is a piece on the worker that measured it; white is waiting.",
            [Tiles(_work_tiles(document["work"])), make_timeline(spans)],
        )
    )
    if ledger.findings:
        sections.append(Section("What the checks found", "", [Lines(ledger.findings)]))
    return render("Recordings measured again", summarise(document), sections)


def summarise(document: Mapping[str, Any]) -> str:
    """Return the result in a sentence."""
    totals = document["totals"]
    text = (
        f"{totals['volume_mm3'] * 1e-9:.3f} ± {totals['sigma_mm3'] * 1e-9:.3f} m³ passed on "
        f"{sum(document['standings'].values()) * 1e-3:.1f} m of belt in {document['recordings']} recordings"
    )
    missing = document["standings"]["missing"]
    if missing > 0:
        text += f"; {missing * 1e-3:.1f} m were not measured"
    return text + "."


def _totals_tiles(document: Mapping[str, Any]) -> list[Tile]:
    totals, lengths = document["totals"], document["standings"]
    mass = totals["mass_kg"]
    tiles = [
        Tile("volume", f"{totals['volume_mm3'] * 1e-9:.3f}", "m³", f"σ {totals['sigma_mm3'] * 1e-9:.3f} m³"),
        Tile("belt", f"{sum(lengths.values()) * 1e-3:.1f}", "m", f"{totals['records']} records"),
        Tile("valid", f"{lengths['valid'] * 1e-3:.1f}", "m", f"degraded {lengths['degraded'] * 1e-3:.1f} m"),
        Tile("missing", f"{lengths['missing'] * 1e-3:.1f}", "m"),
        Tile("recordings", str(document["recordings"]), "", f"{document['frames']} frames"),
    ]
    if mass is not None and math.isfinite(mass):
        tiles.insert(1, Tile("mass", f"{mass * 1e-3:.3f}", "t"))
    return tiles


def _work_tiles(work: Mapping[str, Any]) -> list[Tile]:
    if not work["measured_now"]:
        return [Tile("measured now", "0", "pieces", "everything was measured by earlier runs")]
    setup_s, overlap = work["setup_s_per_piece"], work["overlap_share"]
    return [
        Tile("throughput", f"{work['frames_per_s']:.2f}", "frames/s", f"{work['wall_s']:.0f} s in this run"),
        Tile("workers", str(work["workers"]), "", f"busy {100 * work['efficiency']:.0f} % of the time"),
        Tile("work", f"{work['worker_s'] / 3600:.2f}", "core h", f"{work['measured_now']} pieces"),
        Tile("fixed cost", f"{setup_s:.2f}", "s a piece", f"overlaps {100 * overlap:.1f} % of the frames"),
        Tile("read", f"{work['read_bytes'] / 2**30:.2f}", "GiB", f"{work['read_s']:.0f} s beside the work"),
    ]


def _table(columns: Sequence[str], rows: Sequence[tuple[str, str]]) -> Table:
    more = f"{len(rows) - _MOST_ROWS} more are in reprocessing.json" if len(rows) > _MOST_ROWS else ""
    return Table(columns, [list(row) for row in rows[:_MOST_ROWS]], more)
