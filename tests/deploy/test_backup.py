"""The backup script: whole copies of a database in use, and their number."""

from __future__ import annotations

import runpy
import shutil
from pathlib import Path
from threading import Event, Thread

import pytest

from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.sinks.ledgers import ledger

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
SETTINGS = HistorySettings(reserve_mib=1)


@pytest.fixture(scope="module")
def backup():
    return runpy.run_path(str(DEPLOY / "backup.py"))["main"]


@pytest.fixture
def plant(tmp_path):
    """Data with a history of 70 records, settings, and what lies beside them."""
    data, settings = tmp_path / "data", tmp_path / "settings"
    historian = Historian(data, SETTINGS)
    historian.write(ledger(70))
    (data / "recordings" / "ring").mkdir(parents=True)
    (data / "recordings" / "ring" / "1.tiff").write_bytes(b"large")
    (data / "days").mkdir(exist_ok=True)
    (data / "days" / "2020-01-01.parquet").write_bytes(b"a day, for the copy only")
    (data / "days" / "half.parquet.part").write_bytes(b"half")
    (data / "encoder.json").write_text("{}")
    settings.mkdir()
    (settings / "project.toml").write_text("name = 'belt'\n")
    yield data, settings, historian
    historian.close()


def restored(target: Path, place: Path) -> Historian:
    shutil.copytree(target / "data", place)
    return Historian(place, SETTINGS)


def test_a_backup_made_while_it_writes_is_whole(backup, plant, tmp_path, capsys):
    data, settings, historian = plant
    stop = Event()

    def write():
        for record in ledger(2000, first=71, sections=False):
            if stop.is_set():
                break
            historian.write([record])

    writing = Thread(target=write)
    writing.start()
    try:
        assert backup([str(data), str(tmp_path / "backups"), "--settings", str(settings)]) == 0
    finally:
        stop.set()
        writing.join()
    target = Path(capsys.readouterr().out.strip())
    assert (target / "settings" / "project.toml").read_text() == "name = 'belt'\n"
    assert (target / "data" / "encoder.json").is_file()
    assert not (target / "data" / "recordings").exists()
    assert not list(target.rglob("*.part"))
    day = target / "data" / "days" / "2020-01-01.parquet"
    assert day.is_file()
    day.unlink()
    history = restored(target, tmp_path / "again")
    try:
        totals, found = history.totals, history.records(0, 1 << 62, 10_000)
        assert history.repair_message == ""
        assert [record.number for record in found] == [*range(1, totals.records + 1)]
        assert totals.records >= 70
        assert totals.volume_mm3 == pytest.approx(sum(record.volume_mm3 for record in found))
        history.write(ledger(3, first=totals.records + 1))  # and it goes on
        assert history.totals.records == totals.records + 3
    finally:
        history.close()


def test_the_newest_are_kept(backup, plant, tmp_path):
    data, _, _ = plant
    target = tmp_path / "backups"
    for day in range(1, 5):
        (target / f"2020-01-0{day}T024000Z").mkdir(parents=True)
    assert backup([str(data), str(target), "--keep", "3"]) == 0
    names = sorted(path.name for path in target.iterdir())
    assert names[:2] == ["2020-01-03T024000Z", "2020-01-04T024000Z"]
    assert len(names) == 3


def test_what_cannot_be_backed_up_leaves_nothing_behind(backup, plant, tmp_path, capsys):
    data, _, _ = plant
    (data / "users.db").write_bytes(b"this is no database" * 100)
    assert backup([str(data), str(tmp_path / "backups")]) == 1
    assert "no backup was made" in capsys.readouterr().err
    assert list((tmp_path / "backups").iterdir()) == []


def test_a_folder_without_history_is_refused(backup, tmp_path, capsys):
    assert backup([str(tmp_path), str(tmp_path / "backups")]) == 1
    assert "no history.db" in capsys.readouterr().err
