"""The material test's file: runs and the zero over whole turns, from captures or from the plant's own records.

What was answered is in `commission.json` from the moment on, and what was measured is in the plant's records; so
nothing is lost when browser, page or plant end in between. The end of the zero is found, not stated: it is the record
with which the belt has turned whole times since its beginning.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from beltscape.commissioning import trial
from beltscape.commissioning.project_text import format_table, format_value
from beltscape.commissioning.state import (
    CommissionSettings,
    CommissionState,
    RunAnswer,
    SampleAnswer,
    ZeroAnswer,
)
from beltscape.commissioning.steps import TEST_FILE, name_flow
from beltscape.core.errors import InputError, SettingsError
from beltscape.core.ledger import BeltRecord
from beltscape.files.atomic import write_text
from beltscape.pipeline.certifying.stretches import to_ns
from beltscape.sinks.historian.day_files import UNBOUNDED
from beltscape.sinks.historian.periods import read_records
from beltscape.sinks.historian.reading import find_database, read_history

DATA = "data"
"""Folder of the plant's records in the commissioning's folder."""
_MOST_RECORDS = 200_000
"""Records of a zero test: eleven hours at five a second."""
_SPARE = 0.5
"""Part of a record's length by which the belt may end before whole turns: its nearest record is taken."""


def require_answers(settings: CommissionSettings) -> None:
    """Raise SettingsError with the first answer that a material test lacks, before anything is measured for it."""
    if len(settings.runs) < 2:
        raise SettingsError("runs: give two runs or more of known mass or volume, or material_test=FILE")
    for number, run in enumerate(settings.runs, 1):
        where = f"runs: {number} ({run.load})"
        if run.capture is None and (run.begin is None or run.end is None):
            raise SettingsError(f"{where}: give its capture, or begin and end in the plant's records")
        if run.mass_kg is None and run.volume_m3 is None:
            raise SettingsError(f"{where}: give its mass_kg or volume_m3")
    zero = settings.zero
    if (zero.capture is not None or zero.begin is not None) and zero.belt_length_m is None:
        raise SettingsError(
            "zero.belt_length_m: give the length of the endless belt, m: the zero is over whole turns"
        )


def write_test(state: CommissionState) -> None:
    """Write the material test's file of what was answered.

    Raises
    ------
    SettingsError, InputError
        Where too little was answered, or the belt has not turned whole times since the zero's beginning.
    """
    settings = state.settings
    require_answers(settings)
    reference = {key: value for key, value in settings.reference.model_dump().items() if value != ""}
    head = {
        "name": "commissioning",
        "operator": settings.operator,
        "belt_length_m": settings.zero.belt_length_m,
    }
    lines = ["".join(f"{key} = {format_value(value)}\n" for key, value in head.items() if value)]
    kinds = {"volume_reference" if run.mass_kg is None else "reference" for run in settings.runs}
    lines += [format_table(kind, reference) for kind in sorted(kinds)]
    lines += [format_table(name, sample) for name, sample in _list_samples(settings.samples)]
    lines += [format_table("zero", zero) for zero in _list_zero(state)]
    lines += [format_table("runs", dict(_list_run(state, run)), is_list=True) for run in settings.runs]
    write_text(state.folder / TEST_FILE, "\n".join(lines))


def _list_samples(samples: SampleAnswer) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the tables of the samples that were taken."""
    if samples.density_kg_m3 is not None:
        yield "density", {"kg_m3": samples.density_kg_m3, "sigma_kg_m3": samples.density_sigma_kg_m3}
    if samples.moisture_percent is not None:
        yield (
            "moisture",
            {"percent": samples.moisture_percent, "sigma_percent": samples.moisture_sigma_percent},
        )


def _list_run(state: CommissionState, run: RunAnswer) -> Iterator[tuple[str, Any]]:
    yield "load", run.load
    if run.capture is not None:
        yield "flow", name_flow(run.capture)
    else:
        assert run.begin is not None
        assert run.end is not None
        yield "begin", run.begin.isoformat()
        yield "end", run.end.isoformat()
    if run.mass_kg is not None:
        yield "mass_kg", run.mass_kg
    else:
        is_trial = state.settings.source == "trial"
        yield "volume_m3", trial.compute_true_m3(state, run) if is_trial else run.volume_m3
    if run.ticket:
        yield "ticket", run.ticket


def _list_zero(state: CommissionState) -> Iterator[dict[str, Any]]:
    """Yield the table of the zero test, if it was made."""
    zero = state.settings.zero
    if zero.capture is None and zero.begin is None:
        return
    table: dict[str, Any] = {"revolutions": zero.revolutions}
    if zero.capture is not None:
        yield {**table, "flow": name_flow(zero.capture)}
    else:
        yield {**table, "records": list(find_zero_records(state.folder / DATA, zero))}


def find_zero_records(data: Path, zero: ZeroAnswer) -> tuple[int, int]:
    """Return the first and the last record of whole turns of the belt since the zero's beginning.

    Raises
    ------
    InputError
        Where the belt has not turned so often since; it says how often.
    """
    assert zero.begin is not None
    assert zero.belt_length_m is not None
    records = _read_since(data, to_ns(zero.begin))
    needed, passed = zero.revolutions * zero.belt_length_m * 1e3, 0.0
    for record in records:
        passed += record.length_mm
        if passed >= needed - _SPARE * record.length_mm:
            return records[0].number, record.number
    raise InputError(
        f"zero: the belt has turned {passed / (zero.belt_length_m * 1e3):.2f} of {zero.revolutions} times since "
        f"{zero.begin.isoformat()}: let the empty belt run on, or give another begin or belt_length_m"
    )


def count_turns(data: Path, zero: ZeroAnswer) -> float | None:
    """Return how often the belt has turned since the zero's beginning; None while that cannot be known."""
    if zero.begin is None or zero.belt_length_m is None:
        return None
    try:
        records = _read_since(data, to_ns(zero.begin))
    except InputError:
        return None
    return sum(record.length_mm for record in records) / (zero.belt_length_m * 1e3)


def _read_since(data: Path, begin_ns: int) -> Sequence[BeltRecord]:
    path = find_database(data)

    def read(connection: sqlite3.Connection) -> Sequence[BeltRecord]:
        (shift_ns,) = connection.execute("SELECT coalesce(shift_ns, 0) FROM ledger").fetchone()
        times = (begin_ns, UNBOUNDED)
        return read_records(
            connection, path.parent / "days", times, 0, _MOST_RECORDS, shift_ns, sections=False
        )

    return read_history(path, read)
