"""Closed days as files, and removal of old data."""

from __future__ import annotations

import math
from dataclasses import replace

import pyarrow.parquet as pq
import pytest

from beltscape.core.errors import InputError
from beltscape.sinks.historian import Historian
from beltscape.sinks.historian.day_files import read_day, read_summary
from beltscape.sinks.settings import HistorySettings
from tests.sinks.ledgers import START_NS, ledger, same, same_section

ALWAYS = (0, 1 << 62)
HOUR_NS = 3_600_000_000_000
DAY_NS = 24 * HOUR_NS


def settings(**values) -> HistorySettings:
    return HistorySettings(reserve_mib=1, **values)


def names(folder) -> list[str]:
    return sorted(path.name for path in (folder / "days").glob("*"))


def in_database(historian) -> list[int]:
    with historian._store.readers.borrow() as connection:
        return [row[0] for row in connection.execute("SELECT number FROM records ORDER BY number")]


@pytest.fixture
def records():
    """Five days, one every hour."""
    return ledger(120, start_ns=START_NS // DAY_NS * DAY_NS, every_ns=HOUR_NS)


def test_days_that_are_over_become_files_and_read_back_from_them(tmp_path, records):
    historian = Historian(tmp_path, settings(database_days=2))
    historian.write(records)
    before = historian.totals, historian.ledger_end
    historian.maintain(records[-1].wall_ns)
    assert historian.trouble == ""
    assert names(tmp_path) == [f"2026-09-{day}.parquet" for day in (21, 22, 23, 24)]
    assert in_database(historian) == list(range(73, 121))
    assert (historian.totals, historian.ledger_end) == before
    found = historian.records(*ALWAYS, limit=1000, sections=True)
    assert len(found) == 120 and all(map(same, found, records))
    assert all(same_section(historian.section(r.number), r.section) for r in records)
    page = historian.records(records[30].wall_ns, records[100].wall_ns, limit=20, after=40)
    assert [r.number for r in page] == list(range(41, 61))
    assert historian.series(0, 1 << 61, 1000).volume_mm3.sum() == pytest.approx(before[0].volume_mm3)
    historian.close()
    historian = Historian(tmp_path, settings(database_days=2))
    assert (historian.totals, historian.ledger_end) == before
    historian.maintain(records[-1].wall_ns)
    assert len(names(tmp_path)) == 4
    historian.close()


def test_a_day_file_is_the_same_to_the_byte(tmp_path, records):
    contents = []
    for place in ("one", "two"):
        historian = Historian(tmp_path / place, settings())
        step = 5 if place == "one" else 120
        for start in range(0, 120, step):
            historian.write(records[start : start + step])
        historian.maintain(records[-1].wall_ns)
        historian.close()
        contents.append([path.read_bytes() for path in sorted((tmp_path / place / "days").glob("*"))])
    assert contents[0] == contents[1] and len(contents[0]) == 4


def test_a_day_file_is_a_plain_table(tmp_path, records):
    historian = Historian(tmp_path, settings())
    historian.write(records)
    historian.maintain(records[-1].wall_ns)
    historian.close()
    table = pq.read_table(tmp_path / "days" / "2026-09-21.parquet").to_pylist()
    assert len(table) == 24
    assert table[0]["belt_to_mm"] == records[0].belt_mm[1]
    assert table[0]["standing"] == records[0].standing
    assert (
        table[6]["standing"] == "missing"
        and table[6]["volume_mm3"] is None
        and table[6]["section_x_mm"] is None
    )
    assert table[1]["section_x_mm"] == records[1].section.x_mm.tolist()
    assert table[1]["wall_time"].hour == 1


def test_every_record_lies_in_exactly_one_file_however_the_clock_jumps(tmp_path, records):
    """Forward by ten years, back by days, back to 1970's second day; tended all the time."""
    offsets = {
        20: 3650 * DAY_NS,
        22: 0,
        40: -2 * DAY_NS,
        60: 0,
        70: 5 * HOUR_NS,
        80: -START_NS + 5 * DAY_NS,
        82: 0,
    }
    historian = Historian(tmp_path, settings(database_days=1))
    shift, jumped = 0, []
    for place, record in enumerate(records):
        shift = offsets.get(place, shift)
        jumped.append(replace(record, wall_ns=record.wall_ns + shift))
        historian.write(jumped[-1:])
        if place % 5 == 0:
            historian.maintain(jumped[-1].wall_ns)
            assert historian.trouble == ""
    assert historian.totals.volume_mm3 == math.fsum(r.volume_mm3 for r in records)
    assert historian.ledger_end.end_mm == records[-1].belt_mm[1]
    found = historian.records(*ALWAYS, limit=1000, sections=True)
    assert len(found) == 120 and all(map(same, found, jumped))
    historian.maintain(jumped[-1].wall_ns + 2 * DAY_NS)
    filed: list[int] = []
    for path in sorted((tmp_path / "days").glob("*.parquet")):
        about = read_summary(path)
        its = read_day(path, ALWAYS, ALWAYS, 1000, sections=False)
        assert {r.wall_ns // DAY_NS for r in its} == {about.day}
        filed += [r.number for r in its]
    kept = in_database(historian)
    assert len(filed) == len(set(filed))
    # of the newest record's day the last may still be in the database alone
    assert set(filed) | set(kept) == set(range(1, 121))
    historian.close()


def test_a_clock_ten_years_ahead_removes_nothing(tmp_path, records):
    historian = Historian(tmp_path, settings(database_days=3, file_days=5))
    historian.write(records)
    historian.maintain(records[-1].wall_ns + 3650 * DAY_NS)
    assert len(historian.records(*ALWAYS, limit=1000)) == 120
    historian.close()


def test_by_size_the_oldest_leave_the_database_first(tmp_path, records):
    historian = Historian(tmp_path, settings(database_gib=1.5e-4))
    many = ledger(900, start_ns=records[0].wall_ns, every_ns=HOUR_NS // 12)
    historian.write(many)
    totals = historian.totals
    historian.maintain(many[-1].wall_ns)
    kept = in_database(historian)
    assert historian._store.used_bytes() < 1.5e-4 * 2**30 or not kept
    assert kept == list(range(901 - len(kept), 901))
    assert historian.totals == totals
    found = historian.records(*ALWAYS, limit=10_000, sections=True)
    assert len(found) == 900 and all(map(same, found, many))
    more = ledger(10, 901, start_ns=many[-1].wall_ns)
    historian.write(more)
    historian.maintain(many[-1].wall_ns)
    assert len(historian.records(*ALWAYS, limit=10_000)) == 910
    historian.close()


def test_old_files_are_removed_and_the_totals_remain(tmp_path, records):
    historian = Historian(tmp_path, settings(database_days=1, file_days=3))
    historian.write(records)
    totals = historian.totals
    historian.maintain(records[-1].wall_ns)
    assert names(tmp_path) == ["2026-09-23.parquet", "2026-09-24.parquet"]
    assert historian.totals == totals
    assert [r.number for r in historian.records(*ALWAYS, limit=1000)] == list(range(49, 121))
    assert historian.section(5) is None
    # the sums by the hour stay
    assert historian.series(0, 1 << 61, 100).records.sum() == 120
    historian.close()
    historian = Historian(tmp_path, settings(database_days=1, file_gib=1e-6))
    historian.maintain(records[-1].wall_ns)
    assert names(tmp_path) == []
    assert historian.totals == totals
    historian.close()


def test_damaged_day_file_is_rewritten_before_its_records_are_removed(tmp_path, records):
    historian = Historian(tmp_path, settings(database_days=7))
    historian.write(records)
    historian.maintain(records[-1].wall_ns)
    historian.close()
    path = tmp_path / "days" / "2026-09-21.parquet"
    good = path.read_bytes()
    path.write_bytes(good[:-50] + bytes(50))
    historian = Historian(tmp_path, settings(database_days=1))
    historian.maintain(records[-1].wall_ns)
    assert "2026-09-21.parquet" in historian.trouble
    assert in_database(historian)[0] == 1
    historian.maintain(records[-1].wall_ns)
    assert historian.trouble == ""
    assert path.read_bytes() == good
    assert in_database(historian)[0] == 97
    historian.close()


def test_damaged_day_file_is_reported(tmp_path, records):
    historian = Historian(tmp_path, settings(database_days=1))
    historian.write(records)
    historian.maintain(records[-1].wall_ns)
    (tmp_path / "days" / "2026-09-21.parquet").write_bytes(b"PAR1 nothing")
    with pytest.raises(InputError, match="2026-09-21"):
        historian.records(*ALWAYS)
    # other days can be read all the same
    assert len(historian.records(records[24].wall_ns, records[48].wall_ns)) == 24
    historian.close()


def test_a_day_that_cannot_be_written_stays_in_the_database(tmp_path, records):
    (tmp_path / "days").write_text("in the way")
    historian = Historian(tmp_path, settings(database_days=1))
    historian.write(records)
    historian.maintain(records[-1].wall_ns)
    assert "stays in the database" in historian.trouble or "stay in the database" in historian.trouble
    assert len(in_database(historian)) == 120
    (tmp_path / "days").unlink()
    historian.maintain(records[-1].wall_ns)
    assert historian.trouble == ""
    assert len(in_database(historian)) == 24
    historian.close()


def test_only_the_newest_events_stay(tmp_path):
    historian = Historian(tmp_path, settings(events=100))
    for number in range(115):
        historian.add_event("alarm", "overload", str(number))
    historian.maintain(START_NS)
    assert [e.text for e in historian.events(*ALWAYS)] == [str(n) for n in range(114, 14, -1)]
    historian.close()
