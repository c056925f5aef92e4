"""The page of a year's uncertainty: the parts as bars, how they add up, and what would lower the largest."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from matplotlib.figure import Figure

from beltscape.report.drawing.charts import Chart
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.plots import Form, make_panels, use_decimal_mark
from beltscape.report.metrology.certificate import open_metrology_texts
from beltscape.report.metrology.explanation import name_total
from beltscape.report.page import Lines, Section, Table, Tile, Tiles, render
from beltscape.report.production.texts import Texts

_HOW: Mapping[str, str] = {
    "matching": "squares",
    "zero": "zero",
    "density": "product",
    "moisture": "product",
}
"""How a part adds up over the year; all others linearly."""
_NAMED = 3
"""Largest parts with advice."""


def render_budget(document: Mapping[str, Any], language: str, zone: str) -> str:
    """Return the budget as one self-contained page."""
    texts = open_metrology_texts(language, zone)
    sections = [
        Section("", "", [Tiles(_make_tiles(document, texts))]),
        Section(texts("budget.bars"), texts("budget.bars_intro"),
                [Chart.draw(partial(_plot_parts, document, texts), texts("budget.caption")),
                 _make_part_table(document, texts)]),
        Section(texts("budget.advice"), "", [Lines(list_advice(document, texts))]),
        Section(texts("budget.products"), "", [_make_product_table(document, texts)]),
    ]  # fmt: skip
    title = "budget.title" if document["unit"] == "t" else "budget.title_volume"
    return render(
        texts(title, total=name_total(document["total"], texts)),
        summarise_budget(document, texts),
        sections,
        warnings=list_notes(document, texts),
        language=language,
        warnings_title=texts("warnings"),
    )


def summarise_budget(document: Mapping[str, Any], texts: Texts) -> str:
    """Return the result in one sentence."""
    amount, _, expanded = texts.with_sigma(document["amount"], document["expanded"]).partition(" ± ")
    percent = 100 * document["expanded"] / abs(document["amount"]) if document["amount"] else 0.0
    return texts(
        "budget.verdict",
        amount=amount,
        unit=document["unit"],
        expanded=expanded,
        percent=texts.number(percent, 2),
        p=f"{texts.number(100 * document['confidence'], 0)} %",
        largest=texts(f"part_name.{document['largest']}") if document["largest"] else "–",
    )


def list_notes(document: Mapping[str, Any], texts: Texts) -> list[str]:
    """Return what a reader must know."""
    lines = [texts(f"budget.note.{key}") for key in document["notes"]]
    if document["test_sigma_percent"]:
        percent = texts.number(document["test_sigma_percent"], 2)
        lines.append(texts("budget.test", number=document["certificate"], percent=percent))
    return lines


def list_advice(document: Mapping[str, Any], texts: Texts) -> list[str]:
    """Return what would lower the largest parts, the largest first."""
    parts = [one for one in document["budget"] if one["variance_share"] > 0.01][:_NAMED]
    return [
        f"{texts('part_name.' + one['key'])} ({texts.number(100 * one['variance_share'], 0)} %): "
        f"{texts('advice.' + one['key'])}"
        for one in parts
    ]


def _make_tiles(document: Mapping[str, Any], texts: Texts) -> list[Tile]:
    unit = document["unit"]
    amount, _, expanded = texts.with_sigma(document["amount"], document["expanded"]).partition(" ± ")
    sigma = texts.with_sigma(0.0, document["sigma"]).partition("± ")[2]
    share = texts.number(document["relative_percent"], 2)
    factor = texts.number(document["coverage_factor"], 2)
    return [
        Tile(texts("budget.amount"), amount, unit, f"± {expanded} (k = {factor})"),
        Tile(texts("budget.sigma"), sigma, unit),
        Tile(texts("budget.share"), share, "%", "u"),
    ]


def _plot_parts(document: Mapping[str, Any], texts: Texts, form: Form) -> Figure:
    parts = document["budget"]
    most = 18 if form.narrow else 44
    names = [_cut(texts(f"part_name.{one['key']}"), most) for one in parts] + [texts("combined")]
    sigmas = [one["sigma"] for one in parts] + [document["sigma"]]
    colours = [light("first" if number else "second") for number in range(len(parts))] + [light("reference")]
    height = 44 + 24 * len(names)
    figure, (axis,) = make_panels(1, form, height=height, narrow_height=height + 10)
    axis.barh(range(len(names)), sigmas, color=colours, height=0.62)
    axis.set_yticks(range(len(names)), names)
    axis.invert_yaxis()
    axis.set_xlabel(texts("axis.u", unit=document["unit"]))
    axis.grid(axis="x")
    use_decimal_mark([axis], texts("decimal"))
    return figure


def _cut(name: str, most: int) -> str:
    """Return a name of limited length, without what is in brackets where it is too long."""
    short = name if len(name) <= most else name.partition(" (")[0].partition("（")[0]
    return short if len(short) <= most else f"{short[: most - 1]}…"


def _make_part_table(document: Mapping[str, Any], texts: Texts) -> Table:
    amount = abs(document["amount"]) or 1.0
    rows = [
        [
            texts(f"part_name.{one['key']}"),
            texts.with_sigma(0.0, one["sigma"]).partition("± ")[2],
            f"{texts.number(100 * one['sigma'] / amount, 3)} %",
            f"{texts.number(100 * one['variance_share'], 1)} %",
            texts(f"how.{_HOW.get(one['key'], 'linear')}"),
        ]
        for one in document["budget"]
    ]
    columns = [texts("column.source"), f"u, {document['unit']}", texts("budget.share"), texts("column.share")]
    return Table([*columns, texts("budget.how")], rows)


def _make_product_table(document: Mapping[str, Any], texts: Texts) -> Table:
    rows = [[one["product"] or "–", texts.number(one["amount"], 1)] for one in document["by_product"]]
    return Table([texts("explain.product"), f"{texts('budget.amount')}, {document['unit']}"], rows)
