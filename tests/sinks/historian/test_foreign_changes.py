"""A database that another program deletes, empties, replaces or changes while it is open."""

from __future__ import annotations

import os
import sqlite3
from contextlib import closing

import pytest

from beltscape.core.errors import OutputError
from beltscape.files.sqlite_failures import describe_failure
from beltscape.sinks.historian import Historian, NewEvent, database, store
from beltscape.sinks.settings import HistorySettings
from tests.sinks.ledgers import ledger
from tests.thorough import list_cases

ALWAYS = (0, 1 << 62)
SETTINGS = HistorySettings(reserve_mib=1)
RECORDS = ledger(60)


def cut(path) -> None:
    path.write_bytes(b"")


def delete(path) -> None:
    for name in (path.name, f"{path.name}-wal", f"{path.name}-shm"):
        path.with_name(name).unlink(missing_ok=True)


def delete_database_only(path) -> None:
    path.unlink()


def overwrite(path) -> None:
    with path.open("r+b") as file:
        file.write(os.urandom(path.stat().st_size))


def replace(path) -> None:
    other = path.with_name("other.db")
    with closing(sqlite3.connect(other)) as connection:
        connection.execute("CREATE TABLE something (value)")
    other.replace(path)


def execute(path, statement: str) -> None:
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(statement)
        connection.commit()


CHANGES = {
    "cut": cut,
    "deleted": delete,
    "database deleted": delete_database_only,
    "overwritten": overwrite,
    "replaced": replace,
    "rows deleted": lambda path: execute(path, "DELETE FROM records"),
    "end changed": lambda path: execute(path, "UPDATE ledger SET number = 3, state = ''"),
    "end removed": lambda path: execute(path, "DELETE FROM ledger"),
    "table dropped": lambda path: execute(path, "DROP TABLE records"),
}
WHOLE = {"cut", "deleted", "database deleted", "overwritten", "replaced", "end changed", "end removed"}
"""Changes after which every record is still there: the open connection has them."""


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("checkpointed", list_cases([False, True], [False]))
def test_a_foreign_change_is_reported_and_the_ledger_continues(tmp_path, change, checkpointed):
    historian = Historian(tmp_path, SETTINGS)
    historian.begin_run()
    historian.write(RECORDS[:30])
    if checkpointed:
        historian._store.transact(lambda c: c.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall())
    assert historian.repair_message == ""
    CHANGES[change](tmp_path / "history.db")
    historian.verify()
    if change == "overwritten" and not checkpointed:  # the log still has every page: nothing is damaged
        assert [r.number for r in historian.records(*ALWAYS)] == list(range(1, 31))
        historian.close()
        return
    assert "while the program ran" in historian.repair_message
    assert historian.events(*ALWAYS)[0].text == historian.repair_message
    assert historian.trouble == ""
    historian.write(RECORDS[30:])
    volume = sum(r.volume_mm3 for r in RECORDS)
    assert historian.totals.volume_mm3 == pytest.approx(volume, rel=1e-12)
    numbers = [r.number for r in historian.records(*ALWAYS)]
    assert numbers == list(range(1 if change in WHOLE else 31, 61))
    message = historian.repair_message
    historian.verify()
    assert historian.repair_message == message  # one change is reported once
    assert len(historian.events(*ALWAYS)) == 1
    historian.close()
    historian = Historian(tmp_path, SETTINGS)
    assert historian.repair_message == ""
    assert historian.ledger_end.number == 60
    assert [r.number for r in historian.records(*ALWAYS)] == numbers
    historian.close()


@pytest.mark.parametrize("change", [change for change in CHANGES if change != "overwritten"])
def test_a_write_alone_notices_it_too(tmp_path, change):
    historian = Historian(tmp_path, SETTINGS)
    historian.write(RECORDS[:30])
    CHANGES[change](tmp_path / "history.db")
    historian.write(RECORDS[30:40])
    assert "while the program ran" in historian.repair_message
    assert historian.totals.records == 40
    historian.close()


def test_reading_and_own_housekeeping_are_no_foreign_change(tmp_path):
    historian = Historian(tmp_path, SETTINGS)
    for index in range(0, 60, 5):
        historian.write(RECORDS[index : index + 5])
        historian.maintain(RECORDS[-1].wall_ns)
        execute(tmp_path / "history.db", "SELECT count(*) FROM records")
        with (
            closing(sqlite3.connect(tmp_path / "copy.db")) as copy,
            closing(sqlite3.connect(tmp_path / "history.db")) as source,
        ):
            source.backup(copy)
        historian.verify()
        assert historian.repair_message == ""
    historian.close()


def test_an_unreadable_folder_is_reported_and_kept(tmp_path, monkeypatch):
    historian = Historian(tmp_path, SETTINGS)
    historian.write(RECORDS[:30])

    def refuse(_path):
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patch:
        patch.setattr("beltscape.sinks.historian.store._stat", refuse)
        historian.verify()
        assert "Permission denied" in historian.trouble
    historian.verify()
    assert historian.trouble == ""
    assert historian.repair_message == ""
    historian.close()


def test_a_lock_is_named_and_what_was_refused_is_stored_later(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(database, "BUSY_S", 0.1)
    historian = Historian(tmp_path, SETTINGS)
    historian.begin_run()
    holder = sqlite3.connect(tmp_path / "history.db", isolation_level=None)
    holder.execute("BEGIN IMMEDIATE")
    events = [NewEvent("alarm", f"a{k}", "raised", k) for k in range(3)]
    for refused in (lambda: historian.write(RECORDS), lambda: historian.add_events(events)):
        with pytest.raises(OutputError, match=r"another program holds history\.db; close it there"):
            refused()
    historian.verify()
    assert historian.trouble == "" and historian.records(*ALWAYS) == ()  # a lock is no damage
    holder.execute("ROLLBACK")
    historian.write(RECORDS)
    historian.add_events(events)
    assert len(historian.records(*ALWAYS)) == 60
    assert [one.name for one in historian.events(*ALWAYS)] == ["a2", "a1", "a0"]
    assert historian.repair_message == ""
    holder.close()
    historian.close()


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        (sqlite3.SQLITE_BUSY, "another program holds history.db; close it there"),
        (sqlite3.SQLITE_LOCKED_SHAREDCACHE, "another program holds history.db; close it there"),
        (sqlite3.SQLITE_FULL, "the disk is full; free some space"),
        (sqlite3.SQLITE_READONLY_DIRECTORY, "correct the rights of file and folder"),
        (sqlite3.SQLITE_CANTOPEN, "correct the rights of file and folder"),
        (sqlite3.SQLITE_IOERR_WRITE, "the disk fails"),
        (sqlite3.SQLITE_CORRUPT, "it is damaged"),
    ],
)
def test_the_fix_follows_the_cause(tmp_path, code: int, expected: str) -> None:
    error = sqlite3.OperationalError("its own words")
    error.sqlite_errorcode = code
    assert expected in describe_failure(tmp_path / "history.db", error)


def test_no_reader_sees_a_record_behind_the_ledgers_end(tmp_path, monkeypatch) -> None:
    """A record that is committed but not counted yet would let a reader take the ledger for replaced."""
    historian, seen = Historian(tmp_path, SETTINGS), []
    historian.begin_run()
    append = store.append_records

    def append_and_read(*arguments, **settings):
        sums = append(*arguments, **settings)  # committed; the sums are assigned after this returns
        found = historian.records(*ALWAYS, limit=100)
        seen.append((len(found), historian.ledger_end.number, historian.totals.records))
        return sums

    monkeypatch.setattr(store, "append_records", append_and_read)
    for record in RECORDS[:3]:
        historian.write([record])
    assert seen == [(0, 0, 0), (1, 1, 1), (2, 2, 2)]
    assert len(historian.records(*ALWAYS)) == 3
    historian.close()
