"""Migration of databases and day files of older versions."""

from __future__ import annotations

import sqlite3
from dataclasses import replace

import pyarrow.parquet as pq
import pytest

from beltscape.sinks.historian import Historian, database
from beltscape.sinks.historian.day_files import read_day
from beltscape.sinks.historian.ledger import LedgerTotals
from beltscape.sinks.historian.records import COLUMNS, to_row
from beltscape.sinks.settings import HistorySettings
from tests.sinks.ledgers import ledger, same

ALWAYS = (0, 1 << 62)


def test_database_of_the_first_version_continues(tmp_path, monkeypatch):
    records = [replace(r, offset_mm=0.0, section=None) for r in ledger(5)]
    with monkeypatch.context() as older:
        older.setattr(database, "MIGRATIONS", database.MIGRATIONS[:1])
        connection = database.open_writer(tmp_path / "history.db")
    old = COLUMNS[: COLUMNS.index("offset_mm")]
    sums = LedgerTotals()
    for record in records:
        sums = sums.add_record(record)
        marks = ", ".join("?" * len(old))
        connection.execute(
            f"INSERT INTO records ({', '.join(old)}) VALUES ({marks})", to_row(record)[: len(old)]
        )
    # the first version's text knew no offset
    state = sums.text().replace('"offset_mm": 0.0, ', "")
    connection.execute("UPDATE ledger SET state = ?", (_resigned(state),))
    connection.close()
    historian = Historian(tmp_path, HistorySettings(reserve_mib=1))
    assert historian.repair_message == ""
    assert historian.ledger_end.number == 5
    with historian._store.readers.borrow() as reader:
        numbers = reader.execute("SELECT number, offset_mm FROM records").fetchall()
    assert numbers == [(n, 0.0) for n in range(1, 6)]
    historian.write([*records, *ledger(1, 6)])
    historian.close()


def _resigned(text: str) -> str:
    import json
    from zlib import crc32

    document = json.loads(text)
    document["crc32"] = crc32(json.dumps(document["sums"], sort_keys=True).encode())
    return json.dumps(document, sort_keys=True)


def test_day_file_without_a_later_column_reads(tmp_path):
    historian = Historian(tmp_path, HistorySettings(reserve_mib=1))
    records = ledger(30, every_ns=3_600_000_000_000)
    historian.write(records)
    historian.maintain(records[-1].wall_ns)
    historian.close()
    path = tmp_path / "days" / "2026-09-21.parquet"
    table = pq.read_table(path)
    pq.write_table(table.drop_columns(["offset_mm"]), path)
    for sections in (False, True):
        found = read_day(path, ALWAYS, ALWAYS, 1000, sections=sections)
        assert len(found) == table.num_rows
        assert all(
            same(a, replace(b, offset_mm=0.0), sections=sections)
            for a, b in zip(found, records, strict=False)
        )


def test_a_migration_that_fails_changes_nothing(tmp_path, monkeypatch):
    database.open_writer(tmp_path / "history.db").close()
    broken = "CREATE TABLE further (x); INSERT INTO nowhere VALUES (1)"
    monkeypatch.setattr(database, "MIGRATIONS", (*database.MIGRATIONS, broken))
    with pytest.raises(sqlite3.OperationalError, match="nowhere"):
        database.open_writer(tmp_path / "history.db")
    monkeypatch.undo()
    connection = database.open_writer(tmp_path / "history.db")
    assert connection.execute("SELECT count(*) FROM sqlite_master WHERE name = 'further'").fetchone() == (0,)
    connection.close()
