"""The explanation of a total: its stretches, standings, runs, corrections, alarms, and what people did meanwhile.

All records of the total are read and added up again, beside the sums that the ledger keeps.
"""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from beltscape.core.errors import InputError
from beltscape.core.ledger import BeltRecord
from beltscape.core.progress import Reporter
from beltscape.pipeline.auditing.alarms import AlarmEpisode, pair_alarms
from beltscape.pipeline.auditing.total import TotalName
from beltscape.production.sums import ProductionSums, add_up, sum_record
from beltscape.sinks.historian.day_files import UNBOUNDED
from beltscape.sinks.historian.events import Event, Run, read_events, read_journal, read_runs
from beltscape.sinks.historian.ledger import read_sums
from beltscape.sinks.historian.periods import read_records
from beltscape.sinks.historian.production import MINUTE_NS, read_batch, read_product_sums
from beltscape.sinks.historian.reading import find_database, read_history, require_sound

FORMAT = "beltscape-explanation/1"
_PAGE = 20_000
"""Records that are read at once; some 50 MB."""
_MOST_STRETCHES = 400
"""Most stretches in a document; the sums by standing and reason are of all."""
_MOST_EVENTS = 20_000
"""Newest events of a total that are read."""
_BEFORE_NS = 30 * 86_400 * 10**9
"""Time before a total in which an alarm of it may have been raised."""
_AFTER_NS = 7 * 86_400 * 10**9
"""Time after it in which one may have been acknowledged."""
_ROUNDING = 1e-9
"""Rounding of sums, as a share of them."""
CORRECTIONS = ("zero", "settings", "certificate", "product", "history", "maintenance", "note")
"""Kinds of events that change how belt is counted from then on."""


@dataclass(slots=True)
class CountedStretch:
    """Records that follow each other and were counted alike."""

    run: int
    standing: str
    reason: str
    product: str
    batch: int
    density_kg_m3: float
    offset_mm: float
    first: int
    """Number of the first and of the last record."""
    last: int
    from_mm: float
    to_mm: float
    since_ns: int
    until_ns: int
    sums: ProductionSums = field(default_factory=ProductionSums)

    @property
    def key(self) -> tuple[object, ...]:
        """Return what records of one stretch have in common."""
        return (
            self.run,
            self.standing,
            self.reason,
            self.product,
            self.batch,
            self.density_kg_m3,
            self.offset_mm,
        )


@dataclass(frozen=True, slots=True, eq=False)
class ExplainedTotal:
    """How a total came about."""

    name: TotalName
    folder: Path
    stretches: Sequence[CountedStretch]
    runs: Sequence[Run]
    alarms: Sequence[AlarmEpisode]
    events: Sequence[Event]
    """Corrections and what people did, oldest first."""
    stored: ProductionSums | None
    """What the ledger's own sums say; None where they do not cut at the total's ends."""
    batch_name: str = ""

    @property
    def sums(self) -> ProductionSums:
        """Return the sum over all records."""
        return add_up({str(number): one.sums for number, one in enumerate(self.stretches)})

    @property
    def gone(self) -> int:
        """Return how many records of the total are no longer there, because the history keeps limits."""
        return 0 if self.stored is None else max(0, self.stored.records - self.sums.records)

    @property
    def agrees(self) -> bool | None:
        """Return whether the records add up to what the ledger keeps; None where that cannot be compared."""
        own, stored = self.sums, self.stored
        if stored is None or not stored.records or self.gone:
            return None
        scale = max(abs(own.volume_mm3), abs(stored.volume_mm3), 1.0)
        return own.records == stored.records and abs(own.volume_mm3 - stored.volume_mm3) <= _ROUNDING * scale


def explain_total(folder: Path, name: TotalName, reporter: Reporter) -> ExplainedTotal:
    """Return the explanation of a total of the history in ``folder``, which a plant may be writing.

    Raises
    ------
    InputError
        If there is no history, or no record of that total.
    """
    path = find_database(folder)
    return read_history(path, lambda connection: _explain(connection, path, name, reporter))


def _explain(
    connection: sqlite3.Connection, path: Path, name: TotalName, reporter: Reporter
) -> ExplainedTotal:
    require_sound(connection, path)
    times, batch_name = (name.since_ns, name.until_ns), ""
    if name.kind == "batch":
        times, batch_name = _find_batch(connection, path, name)
    records = _read_pages(connection, path.parent / "days", times, name.batch, reporter)
    stretches = join_stretches(records)
    if not stretches:
        raise InputError(
            f"{path}: has no record of {name.text}; give another total, or the folder of its history"
        )
    since_ns, until_ns = min(one.since_ns for one in stretches), max(one.until_ns for one in stretches) + 1
    events = read_events(connection, since_ns, until_ns, _MOST_EVENTS)[::-1]
    journal = read_journal(connection, (since_ns - _BEFORE_NS, until_ns + _AFTER_NS), 0, UNBOUNDED)
    wanted = {one.run for one in stretches}
    return ExplainedTotal(
        name,
        path.parent,
        stretches,
        [run for run in reversed(read_runs(connection, UNBOUNDED)) if run.number in wanted],
        pair_alarms(journal, since_ns, until_ns),
        [one for one in events if one.kind in CORRECTIONS or (one.by and one.kind != "alarm")],
        _read_stored(connection, name),
        batch_name,
    )


def _find_batch(connection: sqlite3.Connection, path: Path, name: TotalName) -> tuple[tuple[int, int], str]:
    """Return the times of a batch, with room for belt that was in view at its end, and its name."""
    found = read_batch(connection, name.batch)
    if found is None:
        raise InputError(
            f"{path}: has no batch {name.batch}; beltscape lists them on the page, under Production"
        )
    end = UNBOUNDED if found.ended_ns is None else found.ended_ns + 3600 * 10**9
    return (found.started_ns, end), found.name


def _read_pages(
    connection: sqlite3.Connection, days: Path, times: tuple[int, int], batch: int, reporter: Reporter
) -> Iterator[BeltRecord]:
    shift_ns, newest = connection.execute("SELECT coalesce(shift_ns, 0), number FROM ledger").fetchone()
    after = 0
    while records := read_records(connection, days, times, after, _PAGE, shift_ns, sections=False):
        yield from (one for one in records if not batch or one.batch == batch)
        after = records[-1].number
        reporter.step("reading records", min(after, newest), max(newest, 1))


def join_stretches(records: Iterable[BeltRecord]) -> list[CountedStretch]:
    """Return the stretches of records in the ledger's order."""
    stretches: list[CountedStretch] = []
    for record in records:
        one = _make_stretch(record)
        last = stretches[-1] if stretches else None
        if last is None or last.key != one.key or last.last + 1 != one.first:
            stretches.append(one)
            continue
        last.last, last.to_mm, last.until_ns = one.last, one.to_mm, one.until_ns
        last.sums += one.sums
    return stretches


def _make_stretch(record: BeltRecord) -> CountedStretch:
    density = math.nan if record.strip is None else record.strip.density_kg_m3
    return CountedStretch(
        run=record.run,
        standing=record.standing,
        reason=record.reason,
        product=record.product,
        batch=record.batch,
        density_kg_m3=-1.0 if math.isnan(density) else density,
        offset_mm=record.offset_mm,
        first=record.number,
        last=record.number,
        from_mm=record.belt_mm[0],
        to_mm=record.belt_mm[1],
        since_ns=record.wall_ns,
        until_ns=record.wall_ns,
        sums=sum_record(record),
    )


def _read_stored(connection: sqlite3.Connection, name: TotalName) -> ProductionSums | None:
    """Return the sums that the ledger keeps of a batch, of a period of whole minutes, or of everything."""
    if name.kind == "batch":
        found = read_batch(connection, name.batch)
        return None if found is None else found.sums
    if name.kind == "period":
        if name.since_ns % MINUTE_NS or name.until_ns % MINUTE_NS:
            return None
        return add_up(read_product_sums(connection, name.since_ns, name.until_ns))
    (state,) = connection.execute("SELECT state FROM ledger").fetchone()
    sums = read_sums(state)
    if sums is None:
        return None
    totals = sums.totals
    return ProductionSums(records=totals.records, volume_mm3=totals.volume_mm3)


def make_explanation_document(explained: ExplainedTotal) -> dict[str, Any]:
    """Return the explanation as plain values: m³, t, m, and ms since 1970."""
    stretches = explained.stretches
    return {
        "format": FORMAT,
        "total": explained.name.text,
        "batch_name": explained.batch_name,
        "history": explained.folder,
        "since_ms": min(one.since_ns for one in stretches) // 1_000_000,
        "until_ms": max(one.until_ns for one in stretches) // 1_000_000,
        "records": [stretches[0].first, stretches[-1].last],
        "belt_m": [stretches[0].from_mm * 1e-3, stretches[-1].to_mm * 1e-3],
        "sums": _describe_sums(explained.sums),
        "stored": None if explained.stored is None else _describe_sums(explained.stored),
        "agrees": explained.agrees,
        "records_gone": explained.gone,
        "standings": _group(stretches, _describe_standing),
        "products": _group(stretches, _describe_product),
        "runs": [
            {
                "run": run.number,
                "began_ms": run.wall_ns // 1_000_000,
                "provenance": dict(run.provenance),
                **_describe_sums(add_up({str(n): s.sums for n, s in enumerate(stretches) if s.run == run.number})),
            }
            for run in explained.runs
        ],
        "stretches": [_describe_stretch(one) for one in stretches[:_MOST_STRETCHES]],
        "further_stretches": max(0, len(stretches) - _MOST_STRETCHES),
        "seams": _list_seams(stretches),
        "alarms": [_describe_alarm(one) for one in explained.alarms],
        "events": [
            {"at_ms": one.wall_ns // 1_000_000, "kind": one.kind, "name": one.name, "text": one.text, "by": one.by}
            for one in explained.events
        ],
    }  # fmt: skip


def _describe_standing(one: CountedStretch) -> dict[str, Any]:
    return {"standing": one.standing, "reason": one.reason}


def _describe_product(one: CountedStretch) -> dict[str, Any]:
    return {"product": one.product, "density_kg_m3": _to_optional(one.density_kg_m3)}


def _to_optional(value: float) -> float | None:
    return None if value < 0 else value


def _describe_sums(sums: ProductionSums) -> dict[str, Any]:
    return {
        "count": sums.records,
        "volume_m3": sums.volume_mm3 * 1e-9,
        "sigma_m3": sums.sigma_mm3 * 1e-9,
        "mass_t": sums.mass_kg * 1e-3,
        "mass_sigma_t": sums.mass_sigma_kg * 1e-3,
        "valid_m": sums.valid_mm * 1e-3,
        "degraded_m": sums.degraded_mm * 1e-3,
        "missing_m": sums.missing_mm * 1e-3,
    }


def _group(
    stretches: Sequence[CountedStretch], describe: Callable[[CountedStretch], dict[str, Any]]
) -> list[dict[str, Any]]:
    """Return the sums of stretches that are described alike, the longest first."""
    found: dict[tuple[object, ...], tuple[dict[str, Any], ProductionSums, int]] = {}
    for one in stretches:
        values = describe(one)
        key = tuple(values.values())
        before = found.get(key, (values, ProductionSums(), 0))
        found[key] = values, before[1] + one.sums, before[2] + 1
    ordered = sorted(found.values(), key=lambda one: -one[1].length_mm)
    return [{**values, "stretches": count, **_describe_sums(sums)} for values, sums, count in ordered]


def _describe_stretch(one: CountedStretch) -> dict[str, Any]:
    return {
        "records": [one.first, one.last],
        "run": one.run,
        "belt_m": [one.from_mm * 1e-3, one.to_mm * 1e-3],
        "since_ms": one.since_ns // 1_000_000,
        "until_ms": one.until_ns // 1_000_000,
        "standing": one.standing,
        "reason": one.reason,
        "product": one.product,
        "batch": one.batch,
        "density_kg_m3": _to_optional(one.density_kg_m3),
        **_describe_sums(one.sums),
    }


def _list_seams(stretches: Sequence[CountedStretch]) -> list[dict[str, Any]]:
    """Return where an encoder began its count anew."""
    return [
        {"record": later.first, "offset_m": (later.offset_mm - earlier.offset_mm) * 1e-3}
        for earlier, later in pairwise(stretches)
        if later.offset_mm != earlier.offset_mm
    ]


def _describe_alarm(one: AlarmEpisode) -> Mapping[str, Any]:
    acknowledged, ended = one.acknowledged_ns, one.ended_ns
    return {
        "name": one.name,
        "raised_ms": one.raised_ns // 1_000_000,
        "ended_ms": None if ended is None else ended // 1_000_000,
        "text": one.text,
        "acknowledged_by": one.acknowledged_by,
        "acknowledged_ms": None if acknowledged is None else acknowledged // 1_000_000,
        "hidden_by": one.hidden_by,
    }
