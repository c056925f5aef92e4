"""The historian on a full disk: nothing acknowledged is lost."""

from __future__ import annotations

import shutil
import sqlite3

import pytest

from beltscape.core.errors import OutputError
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.sinks.ledgers import ledger, same
from tests.sinks.namespaces import run_with_small_disk

ALWAYS = (0, 1 << 62)
SETTINGS = HistorySettings(reserve_mib=1)


class Disk:
    """What is free, as the historian is made to see it: SQLite itself refuses to go beyond."""

    def __init__(self, historian: Historian, monkeypatch) -> None:
        self.store = historian._store
        self.free = True
        monkeypatch.setattr(self.store._reserve, "free_bytes", lambda: 1 << 30 if self.free else 0)
        release = self.store._reserve.release

        def given_up() -> bool:
            there = release()
            if there:
                self.allow(25)
            return there

        monkeypatch.setattr(self.store._reserve, "release", given_up)

    def allow(self, pages: int) -> None:
        """So many pages more."""
        used = self.store.connection.execute("PRAGMA page_count").fetchone()[0]
        self.store.connection.execute(f"PRAGMA max_page_count = {used + pages}")

    def fill(self) -> None:
        self.free = False
        self.allow(0)

    def empty(self) -> None:
        self.free = True
        self.allow(1 << 20)


@pytest.fixture
def historian(tmp_path):
    one = Historian(tmp_path, SETTINGS)
    yield one
    one.close()


@pytest.fixture
def disk(historian, monkeypatch):
    return Disk(historian, monkeypatch)


def in_tens(historian, records) -> int:
    """Write ten at a time until refused; how many were taken."""
    for start in range(0, len(records), 10):
        try:
            historian.write(records[start : start + 10])
        except OutputError:
            return start
    return len(records)


def test_records_and_totals_continue_in_the_reserve_without_sections(historian, disk, tmp_path):
    records = ledger(200)
    historian.write(records[:50])
    disk.fill()
    assert in_tens(historian, records[50:]) == 150
    assert "disk is full" in historian.trouble and "without cross-sections" in historian.trouble
    assert not (tmp_path / "reserve").exists()
    found = historian.records(*ALWAYS, limit=1000, sections=True)
    assert all(same(a, b, sections=False) for a, b in zip(found, records, strict=True))
    assert historian.totals.records == 200
    disk.empty()
    more = ledger(10, 201)
    historian.write(more)
    assert historian.trouble == ""
    assert (tmp_path / "reserve").stat().st_size == 1 << 20
    assert all(map(same, historian.records(*ALWAYS, after=200, sections=True), more))


def test_full_reserve_refuses_records_and_accepts_them_later(historian, disk):
    records = ledger(2000, sections=False)
    disk.fill()
    taken = in_tens(historian, records)
    assert 0 < taken < 2000
    totals = historian.totals
    for _ in range(3):
        with pytest.raises(OutputError, match="free some space"):
            historian.write(records[taken : taken + 10])
    assert historian.totals == totals
    assert historian.ledger_end.number == taken
    disk.empty()
    historian.write(records[taken : taken + 10])
    historian.write(records[taken:])
    assert historian.ledger_end.number == 2000
    assert historian.trouble == ""


def test_missing_reserve_is_reported_at_the_start(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(100, 99, 1))
    historian = Historian(tmp_path, SETTINGS)
    assert "nearly full" in historian.trouble
    monkeypatch.undo()
    historian.write(ledger(1))
    assert historian.trouble == ""
    historian.close()


def test_a_locked_database_is_no_full_disk(historian, tmp_path):
    historian._store.connection.execute("PRAGMA busy_timeout = 10")
    other = sqlite3.connect(tmp_path / "history.db", isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    with pytest.raises(OutputError, match="locked"):
        historian.write(ledger(1))
    other.execute("ROLLBACK")
    other.close()
    assert historian.trouble == ""
    assert (tmp_path / "reserve").exists()
    historian.write(ledger(1))


@pytest.mark.thorough
def test_full_disk_loses_nothing_that_was_acknowledged(tmp_path):
    seen = run_with_small_disk("tests.sinks.historian.small_disk", tmp_path / "disk")
    assert seen["well"] == ["", 200]
    trouble, full = seen["full"]
    assert "disk is full" in trouble
    # the reserve holds thousands of records, then nothing goes
    assert "not written: the disk is full; free some space" in seen["refusal"]
    assert seen["refused"] - full > 2000
    assert seen["read_while_full"] == seen["refused"] == seen["refused_again"]
    assert seen["start"][1] == seen["refused"] and "nearly full" in seen["start"][0]
    assert seen["free"] == ["", seen["refused"] + 50]
    assert seen["reserve"] == [1 << 20, True]
    assert seen["numbers"] and seen["same"]
    there = set(seen["with_section"])
    # sections up to the full disk and again from the moment it was free
    assert {n for n in range(1, 200) if n % 7} <= there
    assert {n for n in range(seen["refused"] + 1, seen["last"] + 1) if n % 7} <= there
    assert not there & set(range(full + 1, seen["refused"] + 1))
    assert seen["events"] == 1
    assert seen["integrity"] == "ok"
