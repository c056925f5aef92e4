"""The page of a rig's drift: what moved over the weeks with σ, the proposal, and what it would change in litres."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from beltscape.report.drawing.charts import Chart, ChartKey, KeyEntry
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.plots import Form, make_panels, use_decimal_mark
from beltscape.report.metrology.certificate import open_metrology_texts
from beltscape.report.page import Lines, Section, Table, Tile, Tiles, render
from beltscape.report.production.texts import Texts

_TURNS = "turn_x_rad", "turn_y_rad", "turn_z_rad"
_SHIFTS = "shift_x_mm", "shift_y_mm", "shift_z_mm"
_LINES = ("first", "second", "third", "fourth", "limit", "accent")


def render_drift(document: Mapping[str, Any], language: str, zone: str) -> str:
    """Return the drift as one self-contained page."""
    texts = open_metrology_texts(language, zone)
    sections = [Section("", "", [Tiles(_make_tiles(document, texts))])]
    if document["estimates"]:
        sections += [
            Section(texts("drift.over_time"), texts("drift.over_time_intro", time=_format_window(document, texts)),
                    [Chart.draw(partial(_plot, document, texts), texts("drift.caption"), _make_key(document))]),
            Section(texts("drift.proposal"), texts("drift.proposal_intro"),
                    [_make_camera_table(document, texts), Lines(_list_actions(document, texts))]),
        ]  # fmt: skip
    if document["changes"]:
        sections.append(Section(texts("drift.changes"), "", [_make_change_table(document, texts)]))
    return render(
        texts("drift.title"),
        summarise_drift(document, texts),
        sections,
        warnings=list_drift_notes(document, texts),
        language=language,
        warnings_title=texts("warnings"),
    )


def summarise_drift(document: Mapping[str, Any], texts: Texts) -> str:
    """Return the result in one sentence."""
    if not document["estimates"]:
        key = "drift.none_yet" if document["reference_ns"] is None else "drift.reference_only"
        return (
            texts(key, time=_format_window(document, texts)) if document["window_s"] else texts("drift.off")
        )
    if not document["has_proposal"]:
        return texts("drift.still")
    who = document["moved"]
    key = "drift.moved_all" if who == "all" else "drift.moved_one"
    return texts(
        key, camera=who, litres=_format_litres(document, texts), percent=_format_percent(document, texts)
    )


def _format_window(document: Mapping[str, Any], texts: Texts) -> str:
    """Return the running time of an estimate in hours, or in minutes where it is less than one."""
    hours = document["window_s"] / 3600
    value, unit = (hours, "h") if hours >= 1 else (60 * hours, "min")
    return f"{texts.number(value, 0 if value == round(value) else 1)} {unit}"


def _format_litres(document: Mapping[str, Any], texts: Texts) -> str:
    return texts.with_sigma(document["change_litres"], document["change_sigma_litres"])


def _format_percent(document: Mapping[str, Any], texts: Texts) -> str:
    newest = document["estimates"][-1]
    return texts.with_sigma(newest["volume_percent"], newest["volume_sigma_percent"])


def list_drift_notes(document: Mapping[str, Any], texts: Texts) -> list[str]:
    """Return what a reader must know."""
    checks = {
        "scale": bool(document["estimates"]),
        "insignificant": document["has_proposal"] and not document["is_significant"],
        "core": document["needs_new_belt"],
        "no_load": bool(document["estimates"]) and not document["week_litres"],
    }
    return [texts(f"drift.note.{key}") for key, holds in checks.items() if holds]


def list_cameras(document: Mapping[str, Any], texts: Texts) -> list[str]:
    """Return a line for each camera that moved, by the newest estimate."""
    if not document["has_proposal"]:
        return []
    return [
        f"{name}: {texts('drift.part.turn')} {turn} mrad, {texts('drift.part.shift')} {shift} mm, "
        f"{texts('drift.part.focal')} {focal} ‰"
        for name, turn, shift, focal, _ in _list_rows(document, texts)
    ]


def _list_rows(document: Mapping[str, Any], texts: Texts) -> list[list[str]]:
    newest = document["estimates"][-1]
    rows: list[list[str]] = []
    for name, each in newest["cameras"].items():
        if not any(each["change"].values()):
            continue
        turn, turn_sigma = _find_length(each, _TURNS)
        shift, shift_sigma = _find_length(each, _SHIFTS)
        row = newest["row_px"].get(name, [None, None])
        focal = texts.with_sigma(1e3 * each["change"]["focal"], 1e3 * each["sigma"]["focal"])
        rows.append([
            name, texts.with_sigma(1e3 * turn, 1e3 * turn_sigma), texts.with_sigma(shift, shift_sigma), focal,
            texts.with_sigma(*row),
        ])  # fmt: skip
    return rows


def _find_length(camera: Mapping[str, Any], names: tuple[str, ...]) -> tuple[float, float]:
    """Return the length of a turn or shift, and its σ without correlations."""
    change = np.array([camera["change"][name] for name in names])
    sigma = np.array([camera["sigma"][name] for name in names])
    length = float(np.linalg.norm(change))
    return length, float(np.linalg.norm(change * sigma) / length) if length else float(np.linalg.norm(sigma))


def _make_tiles(document: Mapping[str, Any], texts: Texts) -> list[Tile]:
    if not document["estimates"]:
        return [Tile(texts("drift.estimates"), "0")]
    newest = document["estimates"][-1]
    zero = texts.with_sigma(newest["after_zero_percent"], newest["after_zero_sigma_percent"])
    return [
        Tile(texts("drift.litres"), _format_litres(document, texts), "l", texts("drift.week")),
        Tile(texts("drift.share"), _format_percent(document, texts), "%"),
        Tile(texts("drift.share_after_zero"), zero, "%"),
        Tile(texts("drift.estimates"), texts.number(len(document["estimates"]), 0)),
    ]


def _plot(document: Mapping[str, Any], texts: Texts, form: Form) -> Figure:
    estimates = document["estimates"]
    days = np.array([one["wall_ns"] for one in estimates], np.float64)
    days = (days - document["reference_ns"]) / 86400e9
    figure, (turns, volume) = make_panels(2, form, height=220, narrow_height=360)
    for index, name in enumerate(estimates[-1]["cameras"]):
        lengths = np.array([_find_length(one["cameras"][name], _TURNS) for one in estimates]) * 1e3
        colour = light(_LINES[index % len(_LINES)])
        turns.errorbar(days, lengths[:, 0], lengths[:, 1], color=colour, marker="o", markersize=3)
    turns.set_ylabel(f"{texts('drift.part.turn')}, mrad")
    share = np.array([(one["volume_percent"], one["volume_sigma_percent"]) for one in estimates])
    volume.errorbar(days, share[:, 0], share[:, 1], color=light("first"), marker="o", markersize=3)
    volume.axhline(0.0, color=light("reference"), linewidth=1)
    volume.set_ylabel(f"{texts('drift.share')}, %")
    for axis in (turns, volume):
        axis.set_xlabel(texts("drift.days"))
        axis.grid()
    use_decimal_mark([turns, volume], texts("decimal"))
    return figure


def _make_key(document: Mapping[str, Any]) -> ChartKey:
    cameras = document["estimates"][-1]["cameras"]
    return ChartKey([KeyEntry(name, _LINES[index % len(_LINES)]) for index, name in enumerate(cameras)])


def _make_camera_table(document: Mapping[str, Any], texts: Texts) -> Table:
    units = {"turn": "mrad", "shift": "mm", "focal": "‰", "rows": "px"}
    columns = [
        texts("drift.camera"),
        *(f"{texts(f'drift.part.{key}')}, {unit}" for key, unit in units.items()),
    ]
    return Table(columns, _list_rows(document, texts) if document["has_proposal"] else [])


def _list_actions(document: Mapping[str, Any], texts: Texts) -> list[str]:
    if not document["has_proposal"]:
        return [texts("drift.nothing_to_take")]
    return [texts("drift.take", number=str(document["newest"])), texts("drift.undo")]


def _make_change_table(document: Mapping[str, Any], texts: Texts) -> Table:
    rows = [
        [str(one["at"]), texts(f"drift.action.{one['action']}"), str(one["estimate"]), one["by"],
         f"{one['before'][:12]} → {one['after'][:12]}"]
        for one in document["changes"]
    ]  # fmt: skip
    columns = ["at", "action", "estimate", "by", "rig"]
    return Table([texts(f"drift.column.{key}") for key in columns], rows)
