"""The page that explains a total: sums, standings, runs, products, alarms, corrections and stretches."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

from beltscape.core.alarm_catalogue import list_keys
from beltscape.core.translatable_message import LANGUAGES_FOLDER
from beltscape.metrology.certificate import APPLIES
from beltscape.report.drawing.charts import KeyEntry
from beltscape.report.metrology.certificate import open_metrology_texts
from beltscape.report.page import Item, Lines, Section, Table, Tile, Tiles, render
from beltscape.report.production.texts import Texts

_DIGITS = 8
"""Digits of a SHA-256 that are shown: enough to tell a plant's files apart."""


def render_explanation(document: Mapping[str, Any], language: str, zone: str) -> str:
    """Return the explanation of a total as one self-contained page."""
    texts = open_metrology_texts(language, zone)
    sections = [
        _make_section("totals", "unit.sigma", [Tiles(_make_tiles(document, texts))], texts),
        _make_section("standings", "explain.standings_intro", [_make_standing_table(document, texts)], texts),
        _make_section("runs", "explain.runs_intro", [_make_run_table(document, texts)], texts),
        _make_section("products", "", [_make_product_table(document, texts)], texts),
        _make_section(
            "alarms", "explain.alarms_intro", [_make_alarm_table(document, language, texts)], texts
        ),
        _make_section("events", "", [_make_event_table(document, texts)], texts),
        _make_section("stretches", "explain.stretches_intro", list(_list_stretches(document, texts)), texts),
    ]
    return render(
        texts("explain.title", total=document["batch_name"] or name_total(document["total"], texts)),
        summarise_total(document, texts),
        sections,
        warnings=list_remarks(document, texts),
        language=language,
        warnings_title=texts("warnings"),
    )


def name_total(total: str, texts: Texts) -> str:
    """Return a total for a title: a day or a year without the word before it."""
    if total == "all":
        return texts("total.all")
    kind, _, rest = total.partition(":")
    return rest if kind in ("day", "year") else total


def _make_section(name: str, intro: str, items: Sequence[Item], texts: Texts) -> Section:
    return Section(texts(f"explain.{name}"), texts(intro) if intro else "", items)


def summarise_total(document: Mapping[str, Any], texts: Texts) -> str:
    """Return the total in one sentence."""
    sums = document["sums"]
    mass = texts.with_sigma(sums["mass_t"], sums["mass_sigma_t"])
    return texts(
        "explain.verdict",
        volume=texts.with_sigma(sums["volume_m3"], sums["sigma_m3"]),
        mass="" if mass == "–" else texts("explain.mass", mass=mass),
        belt=texts.number(_length(sums), 1),
        from_=texts.moment(document["since_ms"]),
        until=texts.moment(document["until_ms"]),
    )


def list_remarks(document: Mapping[str, Any], texts: Texts) -> list[str]:
    """Return what a reader must know: whether the records add up, and what is no longer there."""
    lines = [texts("explain.seams", record=str(one["record"])) for one in document["seams"]]
    if document["records_gone"]:
        return [texts("explain.gone", count=str(document["records_gone"])), *lines]
    key = {True: "agrees", False: "differs", None: "unknown"}[document["agrees"]]
    return [texts(f"explain.{key}"), *lines]


def _length(sums: Mapping[str, Any]) -> float:
    return sums["valid_m"] + sums["degraded_m"] + sums["missing_m"]


def _make_tiles(document: Mapping[str, Any], texts: Texts) -> Sequence[Tile]:
    sums = document["sums"]
    tiles = [
        Tile(
            texts("explain.volume"),
            texts.number(sums["volume_m3"], 2),
            "",
            f"± {texts.number(sums['sigma_m3'], 2)}",
        )
    ]
    if texts.with_sigma(sums["mass_t"], sums["mass_sigma_t"]) != "–":
        note = f"± {texts.number(sums['mass_sigma_t'], 2)}"
        tiles.append(Tile(texts("explain.mass_t"), texts.number(sums["mass_t"], 2), "", note))
    first, last = document["records"]
    tiles.append(Tile(texts("explain.records"), texts.number(sums["count"], 0), "", f"{first} … {last}"))
    tiles.append(Tile(texts("explain.length"), texts.number(_length(sums), 1)))
    return tiles


def _format_sums(one: Mapping[str, Any], texts: Texts) -> list[str]:
    return [
        texts.number(_length(one), 1),
        texts.with_sigma(one["volume_m3"], one["sigma_m3"]),
        texts.with_sigma(one["mass_t"], one["mass_sigma_t"]),
    ]


def _list_sum_columns(texts: Texts) -> list[str]:
    return [texts("explain.length"), texts("explain.volume"), texts("explain.mass_t")]


def _mark_standing(standing: str, texts: Texts) -> KeyEntry:
    role = {"valid": "measured"}.get(standing, standing)
    return KeyEntry(texts(f"standing.{standing}"), role, "square")


def _make_standing_table(document: Mapping[str, Any], texts: Texts) -> Table:
    rows = [
        [_mark_standing(one["standing"], texts), one["reason"], *_format_sums(one, texts)]
        for one in document["standings"]
    ]
    return Table([texts("explain.standing"), texts("explain.reason"), *_list_sum_columns(texts)], rows)


def _make_run_table(document: Mapping[str, Any], texts: Texts) -> Table:
    rows = [
        [
            str(one["run"]),
            texts.moment(one["began_ms"]),
            *(_shorten(one["provenance"].get(part, ""), part, texts) for part in APPLIES),
            one["provenance"].get("certificate", "") or "–",
            *_format_sums(one, texts)[:2],
        ]
        for one in document["runs"]
    ]
    parts = [texts(f"part.{part}") for part in APPLIES]
    head = [texts("explain.run"), texts("explain.began"), *parts, texts("explain.certificate")]
    return Table([*head, *_list_sum_columns(texts)[:2]], rows)


def _shorten(value: str, part: str, texts: Texts) -> str:
    if not value:
        return texts("not_recorded")
    return value if part == "program" else value[:_DIGITS]


def _make_product_table(document: Mapping[str, Any], texts: Texts) -> Table:
    rows = [
        [one["product"] or "–", texts.number(one["density_kg_m3"], 1), *_format_sums(one, texts)]
        for one in document["products"]
    ]
    return Table([texts("explain.product"), texts("explain.density"), *_list_sum_columns(texts)], rows)


@cache
def _read_titles(language: str) -> Mapping[str, str]:
    return json.loads((LANGUAGES_FOLDER / f"{language}.json").read_text(encoding="utf-8"))


def name_alarm(name: str, language: str) -> str:
    """Return the title of an alarm in a language, with its subject; its own name where there is none."""
    titles = _read_titles(language)
    keys = [f"{family}.{key}" for family in ("alarm", "check") for key in list_keys(name)]
    title = next((titles[key] for key in keys if key in titles), "")
    subject = name.partition(":")[2]
    return f"{title} ({subject})" if title and subject else title or name


def _make_alarm_table(document: Mapping[str, Any], language: str, texts: Texts) -> Table | Lines:
    if not document["alarms"]:
        return Lines([texts("explain.no_alarms")])
    rows = [
        [
            name_alarm(one["name"], language),
            texts.moment(one["raised_ms"]),
            texts("explain.open") if one["ended_ms"] is None else texts.moment(one["ended_ms"]),
            _describe_acknowledgement(one, texts),
            "; ".join(one["hidden_by"]) or "–",
            one["text"],
        ]
        for one in document["alarms"]
    ]
    columns = ("alarm", "raised", "ended", "acknowledged", "hidden", "text")
    return Table([texts(f"explain.{name}") for name in columns], rows)


def _describe_acknowledgement(one: Mapping[str, Any], texts: Texts) -> str:
    if not one["acknowledged_by"]:
        return "–"
    return f"{one['acknowledged_by']}, {texts.moment(one['acknowledged_ms'])}"


def _make_event_table(document: Mapping[str, Any], texts: Texts) -> Table | Lines:
    if not document["events"]:
        return Lines([texts("explain.no_events")])
    rows = [
        [f"{one['kind']} {one['name']}", texts.moment(one["at_ms"]), one["by"] or "–", one["text"]]
        for one in document["events"]
    ]
    return Table([texts(f"explain.{name}") for name in ("kind", "at", "by", "text")], rows)


def _list_stretches(document: Mapping[str, Any], texts: Texts) -> Iterator[Table | Lines]:
    rows = [
        [
            f"{one['records'][0]} … {one['records'][1]}",
            texts.moment(one["since_ms"]),
            _mark_standing(one["standing"], texts),
            *_format_sums(one, texts),
        ]
        for one in document["stretches"]
    ]
    columns = ("records", "began", "standing")
    yield Table([*(texts(f"explain.{name}") for name in columns), *_list_sum_columns(texts)], rows)
    if document["further_stretches"]:
        yield Lines([texts("explain.further", count=str(document["further_stretches"]))])
