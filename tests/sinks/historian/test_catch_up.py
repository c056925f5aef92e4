"""The ledger's end, recovered from day files and tables when the database and totals.json are lost."""

from __future__ import annotations

import pytest

from beltscape.core.errors import InputError
from beltscape.sinks.csv_sink import CsvSink
from beltscape.sinks.historian import Historian
from beltscape.sinks.historian.recovery import catch_up
from beltscape.sinks.settings import CsvSettings, HistorySettings
from tests.sinks.ledgers import ledger
from tests.thorough import list_rows

ALWAYS = (0, 1 << 62)
SETTINGS = HistorySettings(reserve_mib=1)
COUNT = 200


def make_history(folder, count: int = COUNT, *, tables: bool = True, close_days: bool = True):
    """A closed history, with a day file of its first hours and tables of all."""
    historian = Historian(folder, SETTINGS)
    records = ledger(count, every_ns=300_000_000_000)
    historian.write(records)
    if close_days:
        historian.maintain(records[-1].wall_ns)
    totals = historian.totals
    historian.close()
    if tables:
        CsvSink(folder / "csv", CsvSettings()).write(records)
    return totals


def lose(folder, database: str, snapshot: str) -> None:
    path = folder / "history.db"
    for file in (path, path.with_name("history.db-wal"), path.with_name("history.db-shm")):
        file.unlink(missing_ok=True)
    if database == "empty":
        path.touch()
    if snapshot == "damaged":
        (folder / "totals.json").write_text((folder / "totals.json").read_text().replace("number", "numbre"))
    elif snapshot == "cut":
        (folder / "totals.json").write_text((folder / "totals.json").read_text()[:100])
    else:
        (folder / "totals.json").unlink()


LOSSES = [
    (database, snapshot) for database in ("empty", "deleted") for snapshot in ("damaged", "cut", "deleted")
]


@pytest.mark.parametrize(
    ("database", "snapshot"), list_rows(LOSSES, [("empty", "damaged"), ("deleted", "deleted")])
)
def test_number_end_and_totals_come_back_from_day_files_and_tables(tmp_path, database, snapshot):
    totals = make_history(tmp_path)
    lose(tmp_path, database, snapshot)
    historian = Historian(tmp_path, SETTINGS)
    assert historian.ledger_end.number == COUNT
    assert historian.ledger_end.end_mm == pytest.approx(ledger(COUNT)[-1].belt_mm[1], abs=1e-3)
    assert historian.totals.records == COUNT
    assert historian.totals.volume_mm3 == pytest.approx(totals.volume_mm3, rel=1e-9)
    assert historian.totals.mass_kg == pytest.approx(totals.mass_kg, rel=1e-4)
    assert historian.totals.valid_mm == pytest.approx(totals.valid_mm, abs=0.1)
    assert historian.totals.missing_mm == pytest.approx(totals.missing_mm, abs=0.1)
    assert totals.sigma_mm3 * 0.99 <= historian.totals.sigma_mm3 <= totals.volume_mm3
    assert "emptied" in historian.repair_message and "days/" in historian.repair_message
    assert historian.events(*ALWAYS)[0].text == historian.repair_message
    # the page has all records again: old ones from the day file, the others from the tables
    assert [r.number for r in historian.records(*ALWAYS, limit=1000)] == list(range(1, COUNT + 1))
    assert historian.begin_run() > 1
    historian.close()
    historian = Historian(tmp_path, SETTINGS)
    assert historian.repair_message == ""
    assert historian.ledger_end.number == COUNT
    historian.close()


def test_day_files_alone_are_enough_for_their_records(tmp_path):
    make_history(tmp_path, tables=False)
    lose(tmp_path, "empty", "damaged")
    historian = Historian(tmp_path, SETTINGS)
    end = historian.ledger_end.number
    assert 100 < end < COUNT
    expected = ledger(end)
    assert historian.ledger_end.end_mm == expected[-1].belt_mm[1]
    assert historian.totals.volume_mm3 == pytest.approx(sum(r.volume_mm3 for r in expected), rel=1e-12)
    historian.close()


def test_tables_alone_are_enough_and_claim_no_sigma(tmp_path):
    totals = make_history(tmp_path, close_days=False)
    lose(tmp_path, "empty", "damaged")
    historian = Historian(tmp_path, SETTINGS)
    assert historian.ledger_end.number == COUNT
    assert historian.totals.volume_mm3 == pytest.approx(totals.volume_mm3, rel=1e-9)
    assert historian.totals.sigma_mm3 == pytest.approx(totals.volume_mm3, rel=1e-6)
    historian.close()


def test_records_that_no_file_has_are_named(tmp_path):
    make_history(tmp_path, close_days=False)
    lose(tmp_path, "empty", "damaged")
    first, *rest = sorted((tmp_path / "csv").iterdir())
    assert rest
    gone = first.read_text().count("\n") - 1
    first.unlink()
    historian = Historian(tmp_path, SETTINGS)
    assert historian.ledger_end.number == COUNT
    assert f"records 1 to {gone} are in no file" in historian.repair_message
    historian.close()


def test_an_older_copy_continues_behind_the_tables(tmp_path):
    make_history(tmp_path, 100)
    copy = (tmp_path / "history.db").read_bytes()
    records = ledger(120, every_ns=300_000_000_000)
    historian = Historian(tmp_path, SETTINGS)
    historian.write(records[100:])
    totals = historian.totals
    historian.close()
    CsvSink(tmp_path / "csv", CsvSettings()).write(records)
    (tmp_path / "history.db").write_bytes(copy)
    (tmp_path / "totals.json").unlink()
    historian = Historian(tmp_path, SETTINGS)
    assert historian.ledger_end.number == 120
    assert historian.totals.volume_mm3 == pytest.approx(totals.volume_mm3, rel=1e-9)
    historian.close()


def test_a_sound_history_is_left_alone(tmp_path):
    make_history(tmp_path)
    historian = Historian(tmp_path, SETTINGS)
    assert historian.repair_message == ""
    assert historian.ledger_end.number == COUNT
    assert historian.events(*ALWAYS) == ()
    historian.close()


def test_files_that_cannot_be_read_are_refused(tmp_path, monkeypatch):
    make_history(tmp_path)
    lose(tmp_path, "empty", "damaged")

    def refuse(_path, _pattern):
        raise PermissionError(13, "Permission denied", str(tmp_path / "days"))

    monkeypatch.setattr(f"{catch_up.__module__}._list_files", refuse)
    with pytest.raises(InputError, match=r"days: cannot be read .Permission denied.*permissions"):
        Historian(tmp_path, SETTINGS)
