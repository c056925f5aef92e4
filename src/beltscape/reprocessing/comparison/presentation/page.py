"""The page of a comparison: verdict, totals, flow over time, where and why both differ."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from beltscape.report.drawing.charts import Entry
from beltscape.report.page import Lines, Section, Table, Tile, Tiles, render
from beltscape.reprocessing.comparison.comparison import Comparison, PairedTotal
from beltscape.reprocessing.comparison.presentation.charts import make_flow_chart
from beltscape.reprocessing.comparison.presentation.texts import (
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
    list_differing,
    list_warnings,
    make_verdict,
)


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


def _make_total_row(name: str, total: PairedTotal, factor: float) -> list[str | Entry]:
    mark = {
        True: Entry("agrees", "measured", "circle"),
        False: Entry("differs", "missing", "cross"),
        None: Entry("no σ", "degraded", "square"),
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
