"""Recovery of a damaged or missing database."""

from __future__ import annotations

import shutil
import sqlite3

import pytest

from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.sinks.ledgers import ledger
from tests.thorough import list_rows

ALWAYS = (0, 1 << 62)
SETTINGS = HistorySettings(reserve_mib=1)
COUNT = 200


@pytest.fixture
def folder(tmp_path):
    """A closed history of 200 records; its first two hours are of the previous day."""
    historian = Historian(tmp_path, SETTINGS)
    records = ledger(COUNT, every_ns=300_000_000_000)
    historian.write(records)
    historian.maintain(records[-1].wall_ns)
    historian.close()
    return tmp_path


def damaged(folder, where: str) -> None:
    path = folder / "history.db"
    data = bytearray(path.read_bytes())
    if where == "cut":
        data = data[: len(data) // 2]
    elif where == "head":
        data[:4096] = bytes(4096)
    elif where == "all":
        data = bytearray(b"\xa5" * len(data))
    elif where == "middle":
        data[8 * 4096 : 20 * 4096] = b"\xa5" * (12 * 4096)
    elif where == "empty":
        data = bytearray()
    path.write_bytes(data)


DAMAGES = [(snapshot, where) for snapshot in (True, False) for where in ("cut", "head", "all", "middle")]


@pytest.mark.parametrize(
    ("snapshot", "where"), list_rows(DAMAGES, [(True, "all"), (True, "middle"), (False, "cut")])
)
def test_damaged_database_is_moved_aside_and_the_ledger_continues(folder, where, snapshot):
    if not snapshot and where == "all":
        pytest.skip("no totals are left to recover")
    damaged(folder, where)
    before = (folder / "history.db").read_bytes()
    if not snapshot:
        (folder / "totals.json").unlink()
    historian = Historian(folder, SETTINGS)
    (moved,) = (folder / "damaged").glob("*/history.db")
    assert moved.read_bytes() == before
    assert "damaged" in historian.repair_message and str(moved.parent) in historian.repair_message
    assert historian.events(*ALWAYS)[0].text == historian.repair_message
    records = ledger(COUNT + 5)
    assert historian.ledger_end.number == COUNT
    assert historian.ledger_end.end_mm == records[COUNT - 1].belt_mm[1]
    assert historian.totals.records == COUNT
    assert historian.begin_run() > 1
    historian.write(records[COUNT:])
    # closed days are in files and can be read; what was only in the database is in the file moved aside
    closed = [r.number for r in historian.records(*ALWAYS, limit=1000)][:-5]
    assert closed == list(range(1, len(closed) + 1))
    assert 100 < len(closed) < COUNT
    historian.maintain(records[-1].wall_ns)
    series = historian.series(0, 1 << 61, 100)
    assert series.records.sum() == len(closed) + 5
    historian.close()
    historian = Historian(folder, SETTINGS)
    assert historian.repair_message == ""
    assert historian.ledger_end.number == COUNT + 5
    historian.close()


def test_missing_or_empty_database_continues_from_the_snapshot(folder):
    for step in (lambda: damaged(folder, "empty"), (folder / "history.db").unlink):
        step()
        historian = Historian(folder, SETTINGS)
        assert historian.ledger_end.number == COUNT
        assert "totals.json" in historian.repair_message
        historian.close()


def test_older_copy_continues_with_the_newest_totals(folder):
    old = (folder / "history.db").read_bytes()
    historian = Historian(folder, SETTINGS)
    more = ledger(
        600, COUNT + 1, every_ns=300_000_000_000, start_ns=ledger(1)[0].wall_ns + COUNT * 300_000_000_000
    )
    historian.write(more)
    historian.maintain(more[-1].wall_ns)
    totals = historian.totals
    historian.close()
    (folder / "history.db").write_bytes(old)
    historian = Historian(folder, SETTINGS)
    assert historian.totals == totals
    assert f"ends with record {COUNT}" in historian.repair_message
    found = [r.number for r in historian.records(*ALWAYS, limit=10_000)]
    # the files written since the copy are known again, and nothing is there twice
    assert found == list(range(1, len(found) + 1))
    assert COUNT < len(found) < 800
    for _ in range(5):
        historian.maintain(more[-1].wall_ns)
    assert historian.series(0, 1 << 61, 100).records.sum() == len(found)
    assert [r.number for r in historian.records(*ALWAYS, limit=10_000)] == found
    historian.close()


def test_damage_while_running_is_repaired(tmp_path):
    historian = Historian(tmp_path, SETTINGS)
    records = ledger(400)
    historian.write(records[:300])
    historian._store.connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    historian._store.connection.execute("PRAGMA cache_size = 0")
    damaged(tmp_path, "middle")
    with sqlite3.connect(tmp_path / "history.db") as other:  # a change of the file makes caches stale
        other.execute("PRAGMA user_version = 1")
    other.close()
    for start in range(300, 400, 10):
        historian.write(records[start : start + 10])
    assert historian.ledger_end.number == 400
    assert historian.totals.records == 400
    assert "damaged" in historian.repair_message
    historian.close()
    historian = Historian(tmp_path, SETTINGS)
    assert historian.ledger_end.number == 400
    historian.close()


def test_damaged_snapshot_is_ignored(folder):
    path = folder / "totals.json"
    path.write_text(path.read_text().replace('"number": 200', '"number": 900'))
    historian = Historian(folder, SETTINGS)
    assert historian.ledger_end.number == COUNT
    historian.close()


def test_a_backup_taken_while_running_is_a_history(tmp_path):
    """As in the manual: VACUUM INTO, then the day files and totals.json."""
    running, restored = tmp_path / "data", tmp_path / "restored"
    historian = Historian(running, SETTINGS)
    records = ledger(COUNT, every_ns=300_000_000_000)
    historian.write(records[:150])
    historian.maintain(records[-1].wall_ns)
    other = sqlite3.connect(f"{(running / 'history.db').as_uri()}?mode=ro", uri=True)
    restored.mkdir()
    other.execute("VACUUM INTO ?", (str(restored / "history.db"),))
    other.close()
    historian.write(records[150:])
    historian.close()
    shutil.copytree(running / "days", restored / "days")
    historian = Historian(restored, SETTINGS)
    assert historian.repair_message == ""
    assert historian.ledger_end.number == 150
    assert [r.number for r in historian.records(*ALWAYS, limit=1000)] == list(range(1, 151))
    historian.write(records[150:])
    historian.maintain(records[-1].wall_ns + 86_400_000_000_000)
    assert [r.number for r in historian.records(*ALWAYS, limit=1000)] == list(range(1, COUNT + 1))
    historian.close()
