"""The page of a material test and of its certificate: results, budget, linearity, runs, and what it applies to."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from beltscape.metrology.certificate import APPLIES, Statement
from beltscape.metrology.document import recommend_density
from beltscape.report.drawing.charts import Chart, ChartKey, KeyEntry
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.plots import Form, make_panels, use_decimal_mark
from beltscape.report.metrology.pictures import LoadPicture
from beltscape.report.page import Item, Lines, Pictures, Properties, Section, Table, Tile, Tiles, render
from beltscape.report.production.texts import Texts, open_texts

PACKAGE = "beltscape.report.metrology"
"""Package of the languages' files."""
_MOST_BARS = 8
"""Largest effects that a chart shows."""
_RECORDS = re.compile(r"records (\d+) to (\d+)")
"""A run of the history in a test's document."""
_JOIN = "\u00a0"
"""Between a number and its unit: no line breaks there (SI brochure 5.4.3)."""
_COLOURS = ("first", "second", "third", "fourth")
"""Roles of the loads' colours, in turn."""


def open_metrology_texts(language: str, zone: str) -> Texts:
    """Return the texts of certificates in a language; InputError if there is none."""
    return open_texts(language, zone, PACKAGE, "--language")


def render_certificate(
    document: Mapping[str, Any],
    pictures: Sequence[LoadPicture],
    language: str,
    zone: str,
    *,
    statement: Statement | None = None,
    fingerprint: str = "",
) -> str:
    """Return the page of a test's document; ``statement`` None: of a test that is not certified."""
    texts = open_metrology_texts(language, zone)
    items = [*document["errors"], *document["results"]]
    sections = [
        Section("", "", [Tiles([_make_tile(one, texts) for one in items[:4]])]),
        Section(texts("what"), "", [_make_identity_table(document, statement, fingerprint, texts)]),
        Section(texts("results"), texts("results_intro", p=_percent(document["confidence"], texts)),
                [_make_result_table(items, texts), *_list_recommendation(document, texts)]),
        Section(texts("budget"), texts("budget_intro"), list(_list_budgets(items, texts))),
        Section(texts("linearity"), texts("linearity_intro"), list(_list_linearity(document, texts))),
        Section(texts("runs"), "", [_make_run_table(document, texts)]),
        Section(texts("references"), "", [_make_reference_table(document, texts)]),
    ]  # fmt: skip
    if pictures:
        panels = [one.panel for one in pictures]
        sections.append(Section(texts("pictures"), "", [Pictures(panels, "", min(3, len(panels)))]))
    sections.append(Section(texts("applies"), texts("applies_intro"), [_make_applies_table(document, texts)]))
    title = texts("title.test", name=document["name"])
    if statement is not None:
        title = texts("title.certificate", number=statement.number)
        sections.append(Section("", texts("signed", fingerprint=fingerprint), []))
    warnings = [texts(f"note.{key}") for key in document["notes"]]
    if statement is None:
        warnings.insert(0, texts("note.draft"))
    return render(
        title, summarise_test(document, texts), sections, warnings=warnings, language=language,
        warnings_title=texts("warnings"),
    )  # fmt: skip


def summarise_test(document: Mapping[str, Any], texts: Texts) -> str:
    """Return the main result in one sentence."""
    found = {one["key"]: one for one in (*document["results"], *document["errors"])}
    for key in ("mass_error", "volume_error", "mass_factor"):
        if key in found:
            return texts(
                f"verdict.{key}", value=format_result(found[key], texts), product=document["product"] or "–"
            )
    return texts("verdict.none")


def format_result(result: Mapping[str, Any], texts: Texts) -> str:
    """Return value ± expanded uncertainty with the unit."""
    text = texts.with_sigma(result["value"], result["expanded"])
    return f"{text} {result['unit']}".strip()


def _make_tile(result: Mapping[str, Any], texts: Texts) -> Tile:
    value, _, expanded = texts.with_sigma(result["value"], result["expanded"]).partition(" ± ")
    factor = texts.number(result["coverage_factor"], 2)
    return Tile(texts(f"result.{result['key']}"), value, result["unit"], f"± {expanded} (k = {factor})")


def _percent(share: float, texts: Texts) -> str:
    return f"{texts.number(100 * share, 0)} %"


def _degrees(value: float | None, texts: Texts) -> str:
    return "∞" if value is None or not math.isfinite(value) else texts.number(value, 0 if value >= 100 else 1)


def _make_identity_table(
    document: Mapping[str, Any], statement: Statement | None, fingerprint: str, texts: Texts
) -> Properties:
    rows: list[tuple[str, str]] = []
    if statement is not None:
        rows += [
            (texts("number"), statement.number),
            (texts("plant"), statement.plant),
            (texts("issued"), f"{texts.moment(statement.issued_ms)} ({texts.zone.key})"),
            (texts("issued_by"), statement.issued_by),
            (texts("expires"), f"{texts.moment(statement.expires_ms)} ({texts.zone.key})"),
            (texts("key"), fingerprint),
        ]
    rows += [
        (texts(key), document[key])
        for key in ("name", "product", "operator", "place", "remark")
        if document[key]
    ]
    return Properties((texts("field"), texts("value")), rows)


def _make_result_table(items: Sequence[Mapping[str, Any]], texts: Texts) -> Table:
    rows = [
        [
            texts(f"result.{one['key']}"),
            f"{texts.with_sigma(one['value'], one['sigma']).partition(' ±')[0]} {one['unit']}".strip(),
            _round_sigma(one["sigma"], texts),
            _degrees(one["degrees_of_freedom"], texts),
            texts.number(one["coverage_factor"], 2),
            _round_sigma(one["expanded"], texts),
            _describe_class(one, texts),
        ]
        for one in items
    ]
    columns = ("result", "value", "u", "degrees", "k", "U", "class")
    return Table([texts(f"column.{name}") for name in columns], rows, texts("class_note"))


def _describe_class(result: Mapping[str, Any], texts: Texts) -> str:
    if "class" not in result:
        return ""
    return "–" if result["class"] is None else texts.number(result["class"], 1)


def _round_sigma(sigma: float, texts: Texts) -> str:
    """Return a σ to two significant digits (GUM 7.2.6)."""
    return texts.with_sigma(0.0, sigma).partition("± ")[2] or "0"


def _list_recommendation(document: Mapping[str, Any], texts: Texts) -> Iterator[Lines]:
    found = recommend_density(document)
    if found is not None:
        yield Lines([texts("recommend", value=f"{found[0]:.6g}", sigma=f"{found[1]:.2g}")])


def _list_budgets(items: Sequence[Mapping[str, Any]], texts: Texts) -> Iterator[Item]:
    """Yield the chart of the first result's budget, and the tables of all that differ from it."""
    if items:
        yield make_budget_chart(items[0], texts)
    for one in items:
        rows = [
            [
                name_effect(part["key"], texts),
                part["type"],
                _round_sigma(part["sigma"], texts),
                _degrees(part["degrees_of_freedom"], texts),
                f"{texts.number(100 * part['variance_share'], 1)} %",
            ]
            for part in one["budget"]
        ]
        rows.append([texts("combined"), "", _round_sigma(one["sigma"], texts), _degrees(one["degrees_of_freedom"], texts), "100 %"])  # noqa: E501  # fmt: skip
        unit = f", {one['unit']}" if one["unit"] else ""
        columns = ("source", "type", "u", "degrees", "share")
        caption = f"{texts('result.' + one['key'])}{unit}"
        yield Table([texts(f"column.{name}") for name in columns], rows, caption)


def name_effect(key: str, texts: Texts) -> str:
    """Return the name of an effect; one that the test's file names is its own name."""
    return texts.words.get(f"effect.{key}", key)


def make_budget_chart(result: Mapping[str, Any], texts: Texts) -> Chart:
    """Return the contributions of a result as bars, with the combined σ."""
    caption = texts("budget_caption", result=texts(f"result.{result['key']}"))
    entries = [KeyEntry(texts("type.A"), "first", "square"), KeyEntry(texts("type.B"), "second", "square"),
               KeyEntry(texts("combined"), "reference", "square")]  # fmt: skip
    return Chart.draw(partial(_plot_budget, result, texts), caption, ChartKey(entries))


def _plot_budget(result: Mapping[str, Any], texts: Texts, form: Form) -> Figure:
    parts = result["budget"][:_MOST_BARS]
    names = [name_effect(part["key"], texts) for part in parts] + [texts("combined")]
    sigmas = [part["sigma"] for part in parts] + [result["sigma"]]
    colours = [light("first" if part["type"] == "A" else "second") for part in parts] + [light("reference")]
    height = 40 + 24 * len(names)
    figure, (axis,) = make_panels(1, form, height=height, narrow_height=height + 10)
    axis.barh(range(len(names)), sigmas, color=colours, height=0.62)
    axis.set_yticks(range(len(names)), [_wrap(name, form) for name in names])
    axis.invert_yaxis()
    axis.set_xlabel(texts("axis.u", unit=result["unit"] or "1"))
    axis.grid(axis="x")
    use_decimal_mark([axis], texts("decimal"))
    return figure


def _wrap(name: str, form: Form) -> str:
    """Return a name that leaves a narrow chart space for its bars."""
    most = 16 if form.narrow else 40
    return name if len(name) <= most else f"{name[: most - 1]}…"


def _list_linearity(document: Mapping[str, Any], texts: Texts) -> Iterator[Item]:
    yield Chart.draw(
        partial(_plot_runs, document, texts), texts("linearity_caption"), _make_load_key(document)
    )
    rows = [
        [
            one["load"],
            texts(f"kind.{one['kind']}"),
            str(one["runs"]),
            texts.number(one["level_m3_h"], 1),
            f"{texts.with_sigma(one['deviation_percent'], one['deviation_sigma_percent'])} %",
            f"{_round_sigma(one['sigma_run_percent'], texts)} %" if one["runs"] > 1 else "–",
        ]
        for one in document["loads"]
    ]
    columns = ("load", "reference", "runs", "level", "deviation", "scatter")
    yield Table([texts(f"column.{name}") for name in columns], rows)
    lines: list[str] = []
    for kind, own in document["repeatability"].items():
        sigma, degrees = _round_sigma(own["sigma_run_percent"], texts), str(own["degrees_of_freedom"])
        lines.append(texts("repeatability", kind=texts(f"kind.{kind}"), sigma=sigma, degrees=degrees))
        for name in ("linearity", "lack_of_fit"):
            if own[name] is not None:
                lines.append(_describe_f_test(name, own[name], texts))
    yield Lines(lines)


def _describe_f_test(name: str, test: Mapping[str, Any], texts: Texts) -> str:
    between, within = test["degrees_of_freedom"]
    key = f"{name}.{'differs' if test['is_significant'] else 'agrees'}"
    probability = test["probability"]
    return texts(
        key,
        f=texts.number(test["f"], 2),
        between=str(between),
        within=str(within),
        p="< 0.001" if probability < 0.001 else f"= {texts.number(probability, 3)}",
    )


def _loads(document: Mapping[str, Any]) -> list[str]:
    return list(dict.fromkeys(run["load"] for run in document["runs"]))


def _make_load_key(document: Mapping[str, Any]) -> ChartKey:
    return ChartKey(
        [KeyEntry(load, _COLOURS[n % len(_COLOURS)], "circle") for n, load in enumerate(_loads(document))]
    )


def _plot_runs(document: Mapping[str, Any], texts: Texts, form: Form) -> Figure:
    figure, (axis,) = make_panels(1, form, height=230, narrow_height=200)
    means = _mean_ratios(document)
    for number, load in enumerate(_loads(document)):
        runs = [run for run in document["runs"] if run["load"] == load]
        levels = [run["level_m3_h"] for run in runs]
        errors = [100 * (run["corrected_m3"] / run["reference"] / means[run["kind"]] - 1) for run in runs]
        axis.plot(levels, errors, "o", color=light(_COLOURS[number % len(_COLOURS)]), markersize=6)
    axis.axhline(0, color=light("reference"), linewidth=1)
    axis.set(xlabel=texts("axis.level"), ylabel=texts("axis.deviation"))
    axis.grid()
    axis.margins(0.15)
    use_decimal_mark([axis], texts("decimal"))
    return figure


def _mean_ratios(document: Mapping[str, Any]) -> dict[str, float]:
    """Return the geometric mean of measured over reference, by kind."""
    ratios: dict[str, list[float]] = {}
    for run in document["runs"]:
        ratios.setdefault(run["kind"], []).append(math.log(run["corrected_m3"] / run["reference"]))
    return {kind: math.exp(float(np.mean(values))) for kind, values in ratios.items()}


def _make_run_table(document: Mapping[str, Any], texts: Texts) -> Table:
    means = _mean_ratios(document)
    rows = [
        [
            f"{run['load']} {run['label']}".strip(),
            _format_reference(run, texts),
            _format_volume(run["measured_m3"], texts),
            _format_volume(run["corrected_m3"], texts),
            texts.number(run["level_m3_h"], 1),
            f"{texts.number(100 * (run['corrected_m3'] / run['reference'] / means[run['kind']] - 1), 2)} %",
            "–" if run["since_ms"] is None else texts.moment(run["since_ms"]),
            _name_source(run["source"], texts),
        ]
        for run in document["runs"]
    ]
    columns = ("run", "reference", "measured", "corrected", "level", "deviation", "began", "source")
    return Table([texts(f"column.{name}") for name in columns], rows)


def _name_source(source: str, texts: Texts) -> str:
    """Return what a run was measured from: records of the history, or a folder by its name."""
    found = _RECORDS.fullmatch(source)
    return source if found is None else texts("records", first=found[1], last=found[2])


def _format_volume(value: float, texts: Texts) -> str:
    """Return a volume in m³ to a cubic centimetre, or from 1 m³ on to a tenth of a litre."""
    return texts.number(value, 4 if value >= 1 else 6)


def _format_reference(run: Mapping[str, Any], texts: Texts) -> str:
    if run["kind"] == "mass":
        return f"{texts.number(run['reference'], 1)}{_JOIN}kg"
    return f"{_format_volume(run['reference'], texts)}{_JOIN}m³"


def _make_reference_table(document: Mapping[str, Any], texts: Texts) -> Table:
    rows: list[list[str]] = []
    for kind, one in document["references"].items():
        unit = "kg" if kind == "mass" else "m³"
        name = ", ".join(part for part in (one["name"], one["certificate"]) if part)
        sigma = f"{texts.short(one['sigma_percent'])} % + {texts.short(one['sigma_constant'])} {unit}"
        rows.append(
            [texts(f"reference.{kind}"), name or "–", sigma, _degrees(one["degrees_of_freedom"], texts)]
        )
    for name, one in document["samples"].items():
        unit = "%" if name == "moisture" else "kg/m³"
        value = f"{texts.short(one['value'])} {unit}"
        rows.append([texts(f"sample.{name}"), value, f"{texts.short(one['sigma'])} {unit}", _degrees(one["degrees_of_freedom"], texts)])  # noqa: E501  # fmt: skip
    zero = document["zero"]
    if zero is not None:
        value = f"{texts.with_sigma(zero['area_mm2'], zero['sigma_mm2']).partition(' ±')[0]} mm²"
        sigma = f"{_round_sigma(zero['sigma_mm2'], texts)} mm²"
        label = texts("sample.zero", revolutions=str(zero["revolutions"]))
        rows.append([label, value, sigma, _degrees(zero["degrees_of_freedom"], texts)])
    columns = ("what", "value", "u", "degrees")
    return Table([texts(f"column.{name}") for name in columns], rows)


def _make_applies_table(document: Mapping[str, Any], texts: Texts) -> Properties:
    applies = document["applies"]
    rows = [(texts(f"part.{part}"), applies.get(part) or texts("not_recorded")) for part in APPLIES]
    return Properties((texts("field"), texts("value")), rows)
