"""The historian: records, sections and periods read back as written."""

from __future__ import annotations

import math
import sqlite3
import threading
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import InputError, SettingsError
from beltscape.sinks.historian import Historian, LedgerEnd, database
from beltscape.sinks.settings import HistorySettings
from tests.optional import require
from tests.sinks.ledgers import START_NS, ledger, same, same_section
from tests.thorough import examples

ALWAYS = (0, 1 << 62)
SETTINGS = HistorySettings(reserve_mib=1)


@pytest.fixture
def historian(tmp_path):
    one = Historian(tmp_path, SETTINGS)
    yield one
    one.close()


def all_same(found, expected) -> bool:
    return len(found) == len(expected) and all(map(same, found, expected))


def test_new_history_is_empty(historian):
    assert historian.ledger_end == LedgerEnd(0, 0, None)
    assert historian.totals.records == 0
    assert historian.trouble == historian.repair_message == ""
    assert historian.records(*ALWAYS) == ()
    assert historian.section(1) is None


def test_records_read_back_with_their_sections(historian):
    records = ledger(60)
    historian.write(records[:1])
    historian.write(records[1:])
    assert all_same(historian.records(*ALWAYS, sections=True), records)
    assert all(same_section(historian.section(r.number), r.section) for r in records)
    assert historian.ledger_end == LedgerEnd(60, 1, records[-1].belt_mm[1], 4711.25)


def test_unknown_values_read_back_as_unknown(historian):
    record = ledger(1)[0]
    record = replace(
        record,
        run_sigma_mm3=math.nan,
        section=None,
        strip=replace(
            require(record.strip),
            time_ns=None,
            belt_position_mm=math.nan,
            speed_mm_s=math.nan,
            density_kg_m3=math.nan,
        ),
    )
    historian.write([record])
    assert all_same(historian.records(*ALWAYS, sections=True), [record])


def test_pages_follow_each_other(historian):
    records = ledger(50, sections=False)
    historian.write(records)
    found, after = [], 0
    while page := historian.records(*ALWAYS, limit=7, after=after):
        found += page
        after = page[-1].number
    assert all_same(found, records)


def test_records_are_limited_to_the_period(historian):
    records = ledger(50, sections=False)
    historian.write(records)
    found = historian.records(records[10].wall_ns, records[20].wall_ns)
    assert [r.number for r in found] == [r.number for r in records[10:20]]


def test_history_continues_after_closing(tmp_path):
    records = ledger(30)
    for start in range(0, 30, 10):
        historian = Historian(tmp_path, SETTINGS)
        assert historian.begin_run() == start // 10 + 1
        assert historian.ledger_end.number == start
        historian.write(records[start : start + 10])
        historian.close()
    historian = Historian(tmp_path, SETTINGS)
    assert all_same(historian.records(*ALWAYS, sections=True), records)
    assert historian.totals.volume_mm3 == math.fsum(r.volume_mm3 for r in records)
    historian.close()


@examples(10)
@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 12)), min_size=1, max_size=12))
def test_repeated_write_has_no_effect(tmp_path_factory, ranges):
    records = ledger(40, sections=False)
    historian = Historian(tmp_path_factory.mktemp("h"), SETTINGS)
    end = 0
    for start, count in ranges:
        first = min(start, end)
        historian.write(records[first : first + count])
        end = max(end, min(40, first + count))
    assert all_same(historian.records(*ALWAYS), records[:end])
    assert historian.totals.volume_mm3 == math.fsum(r.volume_mm3 for r in records[:end])
    historian.close()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: replace(r, number=r.number + 1), "continues with number 6"),
        (lambda r: replace(r, belt_mm=(r.belt_mm[0] + 1e-9, r.belt_mm[1])), "they must meet"),
        (lambda r: replace(r, belt_mm=(r.belt_mm[0], r.belt_mm[0] - 1)), "goes forward"),
        (lambda r: replace(r, belt_mm=(r.belt_mm[0], math.nan)), "goes forward"),
        (lambda r: replace(r, number=3), "already stored"),
    ],
)
def test_a_ledger_with_a_gap_is_refused_whole(historian, change, message):
    records = ledger(7)
    historian.write(records[:5])
    with pytest.raises(InputError, match=message):
        historian.write([change(records[5])])
    with pytest.raises(InputError):
        historian.write([records[5], change(replace(records[6], number=9))])
    assert all_same(historian.records(*ALWAYS, sections=True), records[:5])
    historian.write(records)
    assert historian.ledger_end.number == 7


def test_the_database_itself_refuses_a_gap(historian, tmp_path):
    historian.write(ledger(5))
    other = sqlite3.connect(tmp_path / "history.db")
    for start, number in ((9999.0, 6), (None, 8)):
        with pytest.raises(sqlite3.IntegrityError, match="go on where it ended"):
            other.execute(
                "INSERT INTO records (number, run, from_mm, to_mm, standing, reason, wall_ns, cameras) "
                "SELECT ?, 1, coalesce(?, end_mm), end_mm + 10000, 0, '', 0, 5 FROM ledger",
                (number, start),
            )
    other.close()


def test_stopped_encoder_is_no_gap(historian):
    records = ledger(3, length_mm=0.0)
    historian.write(records)
    assert historian.ledger_end.number == 3
    assert historian.totals.length_mm == 0


def test_folder_is_open_in_one_process_only(historian, tmp_path):
    with pytest.raises(InputError, match="another beltscape"):
        Historian(tmp_path, SETTINGS)


def test_days_keep_their_hour(tmp_path):
    Historian(tmp_path, SETTINGS).close()
    with pytest.raises(SettingsError, match="day_begins_utc_h"):
        Historian(tmp_path, HistorySettings(reserve_mib=1, day_begins_utc_h=5))
    Historian(tmp_path, SETTINGS).close()


def test_older_database_is_migrated(tmp_path, monkeypatch):
    historian = Historian(tmp_path, SETTINGS)
    records = ledger(5)
    historian.write(records)
    historian.close()
    later = "ALTER TABLE records ADD COLUMN moisture REAL; CREATE TABLE further (x)"
    monkeypatch.setattr(database, "MIGRATIONS", (*database.MIGRATIONS, later))
    historian = Historian(tmp_path, SETTINGS)
    assert all_same(historian.records(*ALWAYS, sections=True), records)
    historian.close()
    with sqlite3.connect(tmp_path / "history.db") as connection:
        assert connection.execute("PRAGMA user_version").fetchone()[0] == len(database.MIGRATIONS)
        assert connection.execute("SELECT count(moisture), count(*) FROM records").fetchone() == (0, 5)
    connection.close()
    monkeypatch.undo()
    with pytest.raises(InputError, match="install the version that wrote it"):
        Historian(tmp_path, SETTINGS)


def test_another_programs_database_is_not_changed(tmp_path):
    with sqlite3.connect(tmp_path / "history.db") as connection:
        connection.execute("PRAGMA application_id = 77")
    connection.close()
    with pytest.raises(InputError, match="another program's"):
        Historian(tmp_path, SETTINGS)


def test_events_are_returned_newest_first(historian):
    historian.add_event("alarm", "overload", "812 t/h", wall_ns=START_NS)
    historian.add_event("note", "history", "später", by="Ånna", wall_ns=START_NS + 5)
    found = historian.events(START_NS, START_NS + 6)
    assert [(e.kind, e.name, e.text, e.by) for e in found] == [
        ("note", "history", "später", "Ånna"),
        ("alarm", "overload", "812 t/h", ""),
    ]
    assert historian.events(START_NS, START_NS + 5) == found[1:]
    assert len(historian.events(*ALWAYS, limit=1)) == 1


def test_readers_never_see_half_a_batch_and_never_stop_the_writer(historian):
    records = ledger(400, sections=False)
    stop, wrong = threading.Event(), []

    def read() -> None:
        while not stop.is_set():
            found = historian.records(*ALWAYS, limit=1000)
            if len(found) % 10 or any(a.belt_mm[1] != b.belt_mm[0] for a, b in pairwise(found)):
                wrong.append(len(found))
            historian.series(START_NS, START_NS + 10**11, 50)

    threads = [threading.Thread(target=read) for _ in range(4)]
    for thread in threads:
        thread.start()
    for start in range(0, 400, 10):
        historian.write(records[start : start + 10])
    stop.set()
    for thread in threads:
        thread.join()
    assert not wrong
    assert historian.ledger_end.number == 400


def test_slow_reader_does_not_block_the_writer(historian):
    historian.write(ledger(5))
    with historian._store.readers.borrow() as connection:
        assert connection.execute("SELECT count(*) FROM records").fetchone() == (5,)
        historian.write(ledger(5, 6))
        assert connection.execute("SELECT count(*) FROM records").fetchone() == (5,)
        with pytest.raises(sqlite3.OperationalError, match="readonly"):
            connection.execute("DELETE FROM records")
    assert historian.ledger_end.number == 10


def test_reading_after_closing_is_refused(tmp_path):
    historian = Historian(tmp_path, SETTINGS)
    historian.close()
    with pytest.raises(InputError, match="closed"):
        historian.records(*ALWAYS)
