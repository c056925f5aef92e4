"""The drill of an update: a history of 0.1.0 is migrated, 0.1.0 refuses it, and a restored backup leads back."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from beltscape.core.errors import InputError, OutputError
from beltscape.core.progress import Silent
from beltscape.service.backup import make_backup
from beltscape.service.restoring import restore_backup
from beltscape.sinks.historian import Historian
from beltscape.sinks.historian import database as schema
from beltscape.sinks.historian.ledger import LedgerTotals
from beltscape.sinks.historian.records import COLUMNS, to_row
from beltscape.sinks.settings import HistorySettings
from tests.sinks.ledgers import ledger

FIRST_RELEASE = 3
"""Version of the tables of 0.1.0."""
RECORDS = 20
SETTINGS = HistorySettings(reserve_mib=1)


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project whose history 0.1.0 wrote."""
    data = tmp_path / "plant" / "data"
    data.mkdir(parents=True)
    (tmp_path / "plant" / "rig.json").write_text("{}")
    (tmp_path / "plant" / "belt.json").write_text("{}")
    (tmp_path / "plant" / "project.toml").write_text('[capture]\nfolder = "belt"\n')
    with monkeypatch.context() as older:
        older.setattr(schema, "MIGRATIONS", schema.MIGRATIONS[:FIRST_RELEASE])
        connection = schema.open_writer(data / "history.db")
    columns = COLUMNS[: COLUMNS.index("product")]
    sums = LedgerTotals()
    for record in ledger(RECORDS, sections=False):
        sums = sums.add_record(record)
        marks = ", ".join("?" * len(columns))
        values = to_row(record)[: len(columns)]
        connection.execute(f"INSERT INTO records ({', '.join(columns)}) VALUES ({marks})", values)
    connection.execute("INSERT INTO runs (wall_ns) VALUES (1)")
    connection.execute("UPDATE ledger SET state = ?", (sums.text(),))
    connection.close()
    return tmp_path / "plant" / "project.toml"


def read(database: Path) -> tuple[int, int]:
    """Return version and number of records."""
    with closing(sqlite3.connect(database)) as connection:
        version = connection.execute("PRAGMA user_version").fetchone()[0]
        return version, connection.execute("SELECT count(*) FROM records").fetchone()[0]


def test_update_and_return(project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = project.parent / "data"
    with monkeypatch.context() as older:
        older.setattr("beltscape.service.backup.MIGRATIONS", schema.MIGRATIONS[:FIRST_RELEASE])
        backup = make_backup(project, tmp_path / "backups", "tar.gz", None, Silent())

    historian = Historian(data, SETTINGS)  # the update
    assert historian.repair_message == ""
    assert historian.ledger_end.number == RECORDS
    assert [run.provenance for run in historian.list_runs(9)] == [{}]
    run = historian.begin_run({"rig": "abc"})
    historian.write(ledger(5, first=RECORDS + 1))
    assert historian.list_runs(1)[0].provenance == {"rig": "abc"} and historian.list_runs(1)[0].number == run
    historian.close()
    assert read(data / "history.db") == (len(schema.MIGRATIONS), RECORDS + 5)
    assert read(data / "before_update" / "history.v3.db") == (FIRST_RELEASE, RECORDS)

    with monkeypatch.context() as older:  # the return
        for module in ("beltscape.sinks.historian.database", "beltscape.service.restoring"):
            older.setattr(f"{module}.MIGRATIONS", schema.MIGRATIONS[:FIRST_RELEASE])
        with pytest.raises(InputError, match=r"knows up to 3; .* or restore a backup .*history\.v3\.db"):
            schema.open_writer(data / "history.db")
        done = restore_backup(backup, project.parent, None, Silent(), replace=True)
        schema.open_writer(data / "history.db").close()
    assert read(data / "history.db") == (FIRST_RELEASE, RECORDS)
    (aside,) = done.moved_aside
    assert read(aside / "data" / "history.db") == (len(schema.MIGRATIONS), RECORDS + 5)


def test_without_room_for_the_copy_nothing_is_migrated(
    project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = project.parent / "data"

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr(schema, "commit_file", fail)
        with pytest.raises(OutputError, match="the update copies the history of"):
            Historian(data, SETTINGS)
    assert read(data / "history.db") == (FIRST_RELEASE, RECORDS)
    assert not list((data / "before_update").iterdir())


def test_a_damaged_history_is_repaired_instead_of_copied(project: Path) -> None:
    path = project.parent / "data" / "history.db"
    with closing(sqlite3.connect(path)) as connection:
        root = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'records'").fetchone()[0]
    content = bytearray(path.read_bytes())
    content[(root - 1) * 4096 : root * 4096] = b"\xff" * 4096
    path.write_bytes(content)
    historian = Historian(path.parent, SETTINGS)
    assert "was damaged" in historian.repair_message
    assert historian.ledger_end.number == RECORDS
    historian.close()
