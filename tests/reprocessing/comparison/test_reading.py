"""Histories are read as they are: beside a writer, from day files, without a trace; what is no history is refused."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from beltscape.core.errors import InputError
from beltscape.core.progress import Silent
from beltscape.files.json_text import hash_file
from beltscape.reprocessing.comparison.comparison import compare_histories
from beltscape.reprocessing.comparison.ledger import read_ledger
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.reprocessing.comparison.histories import PROVENANCE, measured, write_history

DAY_NS = 86_400 * 10**9
RECORDS = measured(40)


def contents(folder: Path) -> dict[str, str]:
    return {str(path.relative_to(folder)): hash_file(path) for path in folder.rglob("*") if path.is_file()}


def test_a_history_at_rest_keeps_its_files(tmp_path):
    folder = write_history(tmp_path / "data", RECORDS)
    before = contents(folder)
    assert compare_histories(folder, folder, Silent()).is_identical
    assert contents(folder) == before


def test_a_folder_that_cannot_be_written_is_read(tmp_path):
    folder = write_history(tmp_path / "data", RECORDS)
    folder.chmod(0o500)
    try:
        assert len(read_ledger(folder, Silent()).columns) == len(RECORDS)
    finally:
        folder.chmod(0o700)


def test_a_history_is_read_while_it_is_written(tmp_path):
    historian = Historian(tmp_path / "data", HistorySettings(reserve_mib=1))
    historian.begin_run(PROVENANCE)
    historian.write(RECORDS[:30])
    assert len(read_ledger(tmp_path / "data", Silent()).columns) == 30
    historian.write(RECORDS[30:])
    assert len(read_ledger(tmp_path / "data", Silent()).columns) == 40
    historian.close()
    assert read_ledger(tmp_path / "data", Silent()).runs[1].provenance == PROVENANCE


@pytest.mark.parametrize("endings", [("", "-wal"), ("", "-wal", "-shm")])
def test_what_a_crash_left_is_read_and_stays(tmp_path, endings):
    historian = Historian(tmp_path / "data", HistorySettings(reserve_mib=1))
    historian.write(RECORDS)
    (tmp_path / "crashed").mkdir()
    for ending in endings:
        shutil.copy(tmp_path / f"data/history.db{ending}", tmp_path / "crashed")
    historian.close()
    before = contents(tmp_path / "crashed")
    assert len(read_ledger(tmp_path / "crashed", Silent()).columns) == len(RECORDS)
    after = contents(tmp_path / "crashed")
    assert {name: after.pop(name) for name in ("history.db", "history.db-wal")}.items() <= before.items()
    assert after.keys() <= before.keys()


def test_a_store_has_its_history_in_a_sub_folder(tmp_path):
    plain = write_history(tmp_path / "data", RECORDS)
    write_history(tmp_path / "store" / "history", RECORDS)
    assert compare_histories(plain, tmp_path / "store", Silent()).is_identical


def test_closed_days_are_read_from_their_files(tmp_path):
    spread = [replace(record, wall_ns=record.wall_ns + record.number // 15 * DAY_NS) for record in RECORDS]
    plain, closed = (write_history(tmp_path / name, spread) for name in ("data", "closed"))
    historian = Historian(closed, HistorySettings(reserve_mib=1, database_days=1))
    historian.maintain(spread[-1].wall_ns + DAY_NS)
    historian.close()
    assert list((closed / "days").glob("*.parquet"))
    with closing(sqlite3.connect(closed / "history.db")) as connection:
        assert connection.execute("SELECT count(*) FROM records").fetchone() == (11,)
    assert compare_histories(plain, closed, Silent()).is_identical
    day = next((closed / "days").glob("*.parquet"))
    day.write_bytes(day.read_bytes()[:-40])
    with pytest.raises(InputError, match=day.name):
        read_ledger(closed, Silent())


def test_records_that_are_gone_are_named(tmp_path):
    folder = write_history(tmp_path / "data", RECORDS)
    with closing(sqlite3.connect(folder / "history.db")) as connection, connection:
        connection.execute("DELETE FROM records WHERE number BETWEEN 10 AND 14")
    reporter = Silent()
    assert len(read_ledger(folder, reporter).columns) == 35
    assert "5 records are no longer there" in reporter.warnings[0]


def test_a_record_that_another_program_changed_is_named(tmp_path):
    folder = write_history(tmp_path / "data", RECORDS)
    damage(folder, "UPDATE records SET volume = volume * 1.001 WHERE number = 2")
    reporter = Silent()
    read_ledger(folder, reporter)
    assert "its records add up to" in reporter.warnings[0]


def damage(folder: Path, script: str) -> None:
    with closing(sqlite3.connect(folder / "history.db")) as connection, connection:
        connection.executescript(script)


@pytest.mark.parametrize(
    ("script", "says"),
    [
        ("DELETE FROM records", "has no records"),
        ("PRAGMA user_version = 99", "install the version"),
        ("PRAGMA user_version = 3", "a run of this program updates them"),
        ("PRAGMA application_id = 7", "another program's database"),
        ("DROP TABLE records", "cannot be read"),
        ("DELETE FROM ledger", "cannot be read"),
        ("UPDATE runs SET provenance = '{'", "cannot be read"),
        ("UPDATE records SET standing = 2, quality = 77", "cannot be read"),
        ("UPDATE records SET volume = 'much'", "cannot be read"),
        ("UPDATE records SET from_mm = 1e9, to_mm = 1e9 WHERE number = 5", "not followed by later belt"),
        ("UPDATE records SET to_mm = 9e999 WHERE number = 40", "not followed by later belt"),
    ],
)
def test_what_is_no_sound_history_is_refused(tmp_path, script, says):
    folder = write_history(tmp_path / "data", RECORDS)
    damage(folder, script)
    with pytest.raises(InputError, match=says) as error:
        read_ledger(folder, Silent())
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [b"", b"no database", b"SQLite format 3\0" + bytes(4000)])
def test_a_file_of_another_kind_is_refused(tmp_path, content):
    (tmp_path / "history.db").write_bytes(content)
    with pytest.raises(InputError, match=r"history\.db"):
        read_ledger(tmp_path, Silent())


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_a_torn_database_is_refused_or_read(tmp_path, share):
    folder = write_history(tmp_path / "data", RECORDS)
    whole = (folder / "history.db").read_bytes()
    (folder / "history.db").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InputError, match=r"history\.db"):
        read_ledger(folder, Silent())
