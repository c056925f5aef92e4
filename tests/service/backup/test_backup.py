"""Backup and restore: whole copies of a plant in use, restored elsewhere, and damage named by file."""

from __future__ import annotations

import shutil
import sqlite3
import tarfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Thread

import pytest

from beltscape.core.errors import InputError, OutputError
from beltscape.core.progress import Silent
from beltscape.service.access import Access
from beltscape.service.backup import make_backup
from beltscape.service.backup_archive import FORMS, MANIFEST_FILE, Form, read_archive
from beltscape.service.restoring import check_backup, restore_backup
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.service.access.sample_app import CHEAP, PASSWORD
from tests.sinks.ledgers import ledger

SETTINGS = HistorySettings(reserve_mib=1)
RIGS = "changes.json", f"{'a1' * 32}.json"
PROJECT = """rig = "rig.json"
empty = "empty/belt.json"
[capture]
folder = "belt"
frames_per_s = 5
[web]
tls_certificate = {certificate!r}
tls_key = "site.key"
"""


@dataclass
class Plant:
    """A project with settings, a history of 70 records, a user, and what lies beside them."""

    project: Path
    data: Path
    historian: Historian
    certificate: Path


@pytest.fixture
def plant(tmp_path: Path) -> Iterator[Plant]:
    folder, data = tmp_path / "plant", tmp_path / "plant" / "data"
    certificate = tmp_path / "ssl" / "site.pem"
    for path in (folder / "rig.json", folder / "empty" / "belt.json", folder / "site.key", certificate):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"this is {path.name}")
    (folder / "belt").mkdir()
    (folder / "belt" / "large.tiff").write_bytes(b"raw images are no settings")
    project = folder / "project.toml"
    project.write_text(PROJECT.format(certificate=str(certificate)))
    historian = Historian(data, SETTINGS)
    historian.write(ledger(70))
    access = Access(data, cost=CHEAP)
    access.accounts.add("anna", "engineer", PASSWORD)
    access.close()
    (data / "recordings" / "ring").mkdir(parents=True)
    (data / "recordings" / "ring" / "1.tiff").write_bytes(b"large")
    (data / "days").mkdir(exist_ok=True)
    (data / "days" / "half.parquet.part").write_bytes(b"half")
    (data / "encoder.json").write_text("{}")
    (data / "rigs").mkdir()  # the rigs that a drift replaced
    for name in RIGS:
        (data / "rigs" / name).write_text(f"this is {name}")
    yield Plant(project, data, historian, certificate)
    historian.close()


def back_up(plant: Plant, target: Path, form: Form = "folder") -> Path:
    return make_backup(plant.project, target, form, None, Silent())


def list_files(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("form", FORMS)
def test_a_backup_of_a_plant_in_use_is_restored_on_an_empty_machine(
    plant: Plant, tmp_path: Path, form: Form
) -> None:
    stop = Event()

    def write() -> None:
        for record in ledger(2000, first=71, sections=False):
            if stop.is_set():
                break
            plant.historian.write([record])

    writing = Thread(target=write)
    writing.start()
    try:
        time.sleep(0.05)
        backup = back_up(plant, tmp_path / "backups", form)
    finally:
        stop.set()
        writing.join()
    plant.certificate.unlink()  # an empty machine
    done = restore_backup(backup, tmp_path / "new", None, Silent(), replace=False)
    assert done.project.read_text() == plant.project.read_text()
    assert plant.certificate.read_text() == "this is site.pem"
    files = list_files(tmp_path / "new")
    assert {"project.toml", "rig.json", "empty/belt.json", "site.key", "data/encoder.json"} <= files
    for name in RIGS:
        assert (tmp_path / "new" / "data" / "rigs" / name).read_text() == f"this is {name}"
    assert not [
        name for name in files if "recordings" in name or name.endswith((".part", ".lock", "reserve"))
    ]
    assert not [name for name in files if name.startswith("belt/")]
    access = Access(tmp_path / "new" / "data", cost=CHEAP)
    assert access.accounts.check("anna", PASSWORD)
    access.close()
    history = Historian(tmp_path / "new" / "data", SETTINGS)
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


def test_what_is_there_is_kept(plant: Plant, tmp_path: Path) -> None:
    backup = back_up(plant, tmp_path / "backups")
    with pytest.raises(OutputError, match="a run uses this data folder; stop it first"):
        restore_backup(backup, plant.project.parent, None, Silent(), replace=True)
    plant.historian.close()
    with pytest.raises(OutputError, match="is there already"):
        restore_backup(backup, plant.project.parent, None, Silent(), replace=False)
    plant.project.write_text("changed since")
    done = restore_backup(backup, plant.project.parent, None, Silent(), replace=True)
    assert "[web]" in plant.project.read_text()
    aside = next(path for path in done.moved_aside if path.is_dir())
    assert (aside / "project.toml").read_text() == "changed since"
    assert (aside / "belt" / "large.tiff").is_file()


def test_the_data_may_go_elsewhere(plant: Plant, tmp_path: Path) -> None:
    backup = back_up(plant, tmp_path / "backups", "tar.gz")
    plant.certificate.unlink()
    done = restore_backup(backup, tmp_path / "new", tmp_path / "disk" / "data", Silent(), replace=False)
    assert done.project.read_text().startswith(f'data = "{tmp_path}/disk/data"\nrig = "rig.json"')
    assert (tmp_path / "disk" / "data" / "history.db").is_file()
    assert not (tmp_path / "new" / "data").exists()


@pytest.mark.parametrize("form", FORMS)
def test_damage_is_named_and_leaves_nothing(plant: Plant, tmp_path: Path, form: Form) -> None:
    backup, new = back_up(plant, tmp_path / "backups", form), tmp_path / "new"
    if form == "folder":
        place = backup / "data" / "users.db"
        for damage, message in ((b"x", "data/users.db is damaged"), (None, "data/users.db is missing")):
            if damage is None:
                place.unlink()
            else:
                place.write_bytes(place.read_bytes() + damage)
            with pytest.raises(InputError, match=message):
                restore_backup(backup, new, None, Silent(), replace=False)
        (backup / MANIFEST_FILE).write_text(
            (backup / MANIFEST_FILE).read_text().replace("rig.json", "rog.json")
        )
        message = "its content contradicts its sha256"
    else:
        backup.write_bytes(backup.read_bytes()[: backup.stat().st_size // 2])
        message = "damaged or cut at"
    with pytest.raises(InputError, match=message):
        restore_backup(backup, new, None, Silent(), replace=False)
    with pytest.raises(InputError, match=message):
        check_backup(backup, Silent())
    assert not new.exists()
    assert not list(tmp_path.glob(".*restore"))


@pytest.mark.parametrize("name", ["../evil", "/etc/evil", "data/../../evil", "data/unknown"])
def test_a_file_that_the_manifest_does_not_name_is_refused(plant: Plant, tmp_path: Path, name: str) -> None:
    folder = back_up(plant, tmp_path / "backups")
    path = tmp_path / "evil.tar.gz"
    with tarfile.open(path, "w:gz") as archive:
        archive.add(folder / MANIFEST_FILE, MANIFEST_FILE)
        archive.add(folder / "data" / "encoder.json", name)
    with pytest.raises(InputError, match="is not in its manifest"):
        restore_backup(path, tmp_path / "new", None, Silent(), replace=False)
    assert not (tmp_path / "new").exists()


def test_the_newest_are_kept_and_other_files_stay(plant: Plant, tmp_path: Path) -> None:
    target = tmp_path / "backups"
    for day in range(1, 5):
        (target / f"2020-01-0{day}T024000Z").mkdir(parents=True)
    (target / "notes").mkdir()
    make_backup(plant.project, target, "tar.zst", 3, Silent())
    names = sorted(path.name for path in target.iterdir())
    assert names[:2] == ["2020-01-03T024000Z", "2020-01-04T024000Z"]
    assert (len(names), names[-1]) == (4, "notes")


def test_what_cannot_be_backed_up_leaves_nothing_behind(plant: Plant, tmp_path: Path) -> None:
    (plant.data / "users.db").write_bytes(b"this is no database" * 100)
    with pytest.raises(InputError, match=r"users\.db: cannot be backed up"):
        back_up(plant, tmp_path / "backups")
    assert list((tmp_path / "backups").iterdir()) == []
    shutil.rmtree(plant.data)
    with pytest.raises(InputError, match=r"has no history\.db"):
        back_up(plant, tmp_path / "backups")


def test_a_backup_of_a_newer_program_names_it(plant: Plant, tmp_path: Path, monkeypatch) -> None:
    backup = back_up(plant, tmp_path / "backups")
    monkeypatch.setattr("beltscape.service.restoring.MIGRATIONS", ("first",))
    with pytest.raises(InputError, match=r"this program knows up to 1; install beltscape"):
        check_backup(backup, Silent())


def test_a_failing_disk_changes_nothing(plant: Plant, tmp_path: Path, monkeypatch) -> None:
    backup, new = back_up(plant, tmp_path / "backups"), tmp_path / "new"
    plant.certificate.unlink()
    rename, calls = Path.rename, []

    def fail_late(self: Path, target: Path) -> Path:
        calls.append(self)
        if len(calls) == 2:
            raise OSError(28, "No space left on device", str(target))
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fail_late)
    with pytest.raises(OutputError, match="the disk is full"):
        restore_backup(backup, new, None, Silent(), replace=False)
    assert not new.exists() and not plant.certificate.exists()
    assert not list(tmp_path.glob(".*restore"))


def test_the_copied_database_opens_alone(plant: Plant, tmp_path: Path) -> None:
    backup = back_up(plant, tmp_path / "backups")
    assert not list((backup / "data").glob("*-wal"))
    connection = sqlite3.connect(f"file:{backup / 'data' / 'history.db'}?mode=ro&immutable=1", uri=True)
    assert connection.execute("SELECT count(*) FROM records").fetchone() == (70,)
    connection.close()


@pytest.mark.parametrize("form", FORMS)
def test_a_copied_database_keeps_its_rights(plant: Plant, tmp_path: Path, form: Form) -> None:
    (plant.data / "history.db").chmod(0o640)
    assert (plant.data / "users.db").stat().st_mode & 0o777 == 0o600
    backup = back_up(plant, tmp_path / "backups", form)
    if form == "folder":
        modes = {name: (backup / name).stat().st_mode for name in ("data/users.db", "data/history.db")}
    else:
        with read_archive(backup, form) as members:
            modes = {name: mode for name, _, mode in members}
    assert [modes[f"data/{name}.db"] & 0o777 for name in ("users", "history")] == [0o600, 0o640]
