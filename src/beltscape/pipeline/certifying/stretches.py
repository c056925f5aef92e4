"""What was measured over a stretch of belt: by the records of a plant's history, or by a result of `measure flow`."""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.checks import is_dict
from beltscape.core.errors import InputError
from beltscape.core.ledger import BeltRecord
from beltscape.files.paths import read_text
from beltscape.metrology.settings import StretchSettings
from beltscape.sinks.historian.day_files import UNBOUNDED
from beltscape.sinks.historian.events import read_runs
from beltscape.sinks.historian.periods import read_records
from beltscape.sinks.historian.reading import find_database, read_history

_MOST_MISSING = 0.002
"""Share of belt without a measurement above which nothing is compared. Chosen: below it the guess is 0.1 %."""
_MOST_RECORDS = 500_000
"""Records of a run; 28 hours at five a second."""
_EMPTY_ENDS = 0.05
"""Cross-section at an end, over the mean, from which material lay on the belt there. Chosen."""
Pieces = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredStretch:
    """What was measured over a stretch of belt."""

    source: str
    """Where it comes from, in a few words."""
    pieces: Pieces
    """(n, 4) float64: beginning and end of each strip, mm of belt; its volume, mm³; its own variance, mm⁶."""
    level_m3_h: float
    """Mean flow while the belt moved; NaN: not known."""
    recorded_kg: float
    """Mass by the densities that held then; NaN: one is not known."""
    degraded_share: float
    """Share of the belt that was measured with less certainty."""
    provenance: Mapping[str, str]
    """What it was measured by; a part that is not recorded is absent."""
    since_ns: int | None = None
    until_ns: int | None = None
    """System clock; None: not known."""

    @property
    def volume_m3(self) -> float:
        """Return the volume."""
        return float(self.pieces[:, 2].sum()) * 1e-9

    @property
    def own_sigma_m3(self) -> float:
        """Return σ of it that other stretches do not share."""
        return math.sqrt(float(self.pieces[:, 3].sum())) * 1e-9

    @property
    def length_m(self) -> float:
        """Return the length of belt."""
        return float((self.pieces[:, 1] - self.pieces[:, 0]).sum()) * 1e-3

    @property
    def loaded_ends(self) -> tuple[str, ...]:
        """Return at which ends material lay on the belt: "begin", "end"."""
        lengths = self.pieces[:, 1] - self.pieces[:, 0]
        long = self.pieces[lengths > 0]
        if not len(long):
            return ()
        areas = long[:, 2] / (long[:, 1] - long[:, 0])
        limit = _EMPTY_ENDS * float(areas.max())
        return tuple(name for name, at in (("begin", 0), ("end", -1)) if areas[at] > limit)

    def split(self, parts: int) -> Sequence[float]:
        """Return the mean cross-section, mm², of each of ``parts`` equal lengths."""
        begin, end = float(self.pieces[0, 0]), float(self.pieces[-1, 1])
        edges = np.linspace(begin, end, parts + 1)
        ends = np.concatenate([self.pieces[:1, 0], self.pieces[:, 1]])
        reached = np.concatenate([[0.0], np.cumsum(self.pieces[:, 2])])
        volumes = np.diff(np.interp(edges, ends, reached))
        return [float(volume) for volume in volumes / np.diff(edges)]


def read_stretch(settings: StretchSettings, folder: Path, data: Path, where: str) -> MeasuredStretch:
    """Return what was measured; ``folder`` is that of the test's file, ``data`` that of the plant.

    Raises
    ------
    InputError
        One line that begins with ``where`` if nothing was measured there, or too much belt is missing.
    """
    if settings.flow is not None:
        return read_flow_folder(folder / settings.flow, where)
    return _read_history_stretch(settings, data, where)


def _read_history_stretch(settings: StretchSettings, data: Path, where: str) -> MeasuredStretch:
    path = find_database(data)
    times, after, limit = (-UNBOUNDED, UNBOUNDED), 0, _MOST_RECORDS + 1
    if settings.records is not None:
        first, last = settings.records
        after, limit = first - 1, min(last - first + 1, limit)
    elif settings.begin is not None and settings.end is not None:
        times = to_ns(settings.begin), to_ns(settings.end)

    def read(connection: sqlite3.Connection) -> tuple[Sequence[BeltRecord], dict[int, Mapping[str, str]]]:
        (shift_ns,) = connection.execute("SELECT coalesce(shift_ns, 0) FROM ledger").fetchone()
        records = read_records(
            connection, path.parent / "days", times, after, limit, shift_ns, sections=False
        )
        runs = {run.number: run.provenance for run in read_runs(connection, UNBOUNDED)}
        return records, runs

    records, runs = read_history(path, read)
    if settings.records is not None:
        records = [one for one in records if one.number <= settings.records[1]]
    if not records:
        raise InputError(f"{where}: {path} has no record there; correct begin and end, or records")
    if len(records) > _MOST_RECORDS:
        raise InputError(f"{where}: more than {_MOST_RECORDS} records; a run of a test is shorter")
    provenance = _join_provenance((runs.get(number, {}) for number in {one.run for one in records}), where)
    return make_stretch(records, provenance, where)


def to_ns(moment: datetime) -> int:
    """Return a moment as ns since 1970, exactly."""
    whole = moment.astimezone(UTC).replace(microsecond=0)
    return int(whole.timestamp()) * 10**9 + moment.microsecond * 1000


def _join_provenance(found: Iterable[Mapping[str, str]], where: str) -> Mapping[str, str]:
    """Return the provenance of all runs of a stretch; InputError if they differ."""
    first: Mapping[str, str] = {}
    for number, one in enumerate(found):
        parts = {key: value for key, value in one.items() if key != "certificate"}
        differing = [key for key in {*first, *parts} if number and first.get(key) != parts.get(key)]
        if differing:
            raise InputError(
                f"{where}: {', '.join(sorted(differing))} changed in between; give a stretch without a change"
            )
        first = parts
    return first


def make_stretch(records: Sequence[BeltRecord], provenance: Mapping[str, str], where: str) -> MeasuredStretch:
    """Return what records that follow each other measured; InputError if too much belt is missing."""
    length = sum(one.length_mm for one in records)
    missing = sum(one.length_mm for one in records if one.standing == "missing")
    _require_measured(missing, length, where)
    pieces: list[tuple[float, float, float, float]] = []
    seconds = moved = 0.0
    for one in records:
        strip, volume = one.strip, one.volume_mm3
        variance = 0.0
        if strip is not None:
            common = strip.common_sigma_mm3 if math.isfinite(strip.common_sigma_mm3) else strip.sigma_mm3
            variance = max(strip.sigma_mm3**2 - common**2, 0.0)
            if strip.speed_mm_s > 0:
                seconds, moved = seconds + one.length_mm / strip.speed_mm_s, moved + volume
        pieces.append((*one.belt_mm, 0.0 if math.isnan(volume) else volume, variance))
    return MeasuredStretch(
        source=f"records {records[0].number} to {records[-1].number}",
        pieces=np.array(pieces, np.float64),
        level_m3_h=moved / seconds * 3600e-9 if seconds > 0 else math.nan,
        recorded_kg=sum(one.mass_kg for one in records),
        degraded_share=sum(one.length_mm for one in records if one.standing == "degraded") / length,
        provenance=provenance,
        since_ns=records[0].wall_ns,
        until_ns=records[-1].wall_ns,
    )


def _require_measured(missing_mm: float, length_mm: float, where: str) -> None:
    if not length_mm > 0:
        raise InputError(f"{where}: no belt passed there; correct begin and end, or records")
    if missing_mm > _MOST_MISSING * length_mm:
        raise InputError(
            f"{where}: {100 * missing_mm / length_mm:.1f} % of its belt was not measured; repeat the run"
        )


def read_flow_folder(folder: Path, where: str) -> MeasuredStretch:
    """Return what `measure flow` found; InputError if it cannot be read, or too much belt is missing."""
    path = folder / "flow.json"
    if not path.is_file():
        raise InputError(f"{where}: {path}: no such file; give a folder of beltscape measure flow")
    try:
        return _parse_flow(json.loads(read_text(path)), folder.name, where)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{where}: {path}: is no flow.json of this program ({error}); measure it again"
        ) from error


def _parse_flow(document: Mapping[str, Any], source: str, where: str) -> MeasuredStretch:
    totals, strips = document["totals"], document["strips"]
    lost, length = float(totals["not_counted_mm"]), float(totals["length_mm"])
    _require_measured(lost, length + lost, where)
    pieces = [
        (
            float(one["start_mm"]),
            float(one["end_mm"]),
            float(one["volume_mm3"]),
            max(float(one["sigma_mm3"]) ** 2 - float(one["common_sigma_mm3"]) ** 2, 0.0),
        )
        for one in strips
        if one["start_mm"] is not None and one["end_mm"] is not None
    ]
    mass, flow = totals["mass_t"], totals["mean_volume_flow_m3_h"]
    worse = sum(
        one["end_mm"] - one["start_mm"] for one in strips if one["quality"] in ("degraded", "bridged")
    )
    provenance = document.get("provenance")
    return MeasuredStretch(
        source=source,
        pieces=np.array(pieces, np.float64).reshape(-1, 4),
        level_m3_h=math.nan if flow is None else float(flow),
        recorded_kg=math.nan if mass is None else 1000 * float(mass),
        degraded_share=worse / length,
        provenance=provenance if is_dict(provenance) else {},
    )
