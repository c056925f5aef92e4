"""``beltscape run``: rights of its files, and a damaged users' database."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from beltscape.service.data_rights import restrict_rights
from tests.thorough import list_cases


def list_modes(folder: Path) -> dict[str, int]:
    paths = [folder, *folder.rglob("*")]
    return {str(path.relative_to(folder.parent)): stat.S_IMODE(path.stat().st_mode) for path in paths}


def test_files_of_a_run_are_for_user_and_group(run, plant):
    text = plant.read_text().replace(
        "[history]", "[csv]\nenabled = true\n[recording]\nmode = 'all'\nfree_gib = 0\n[history]"
    )
    plant.write_text(text)
    before = os.umask(0)
    try:
        code, _, err = run("run", plant)
    finally:
        assert os.umask(before) == 0  # the run gives it back
    assert code == 0, err
    modes = list_modes(plant.parent / "data")
    assert {"data/history.db", "data/totals.json", "data/csv", "data/recordings"} <= set(modes)
    assert any(name.endswith(".csv") for name in modes)
    assert {name: oct(mode) for name, mode in modes.items() if mode & 0o027} == {}


def test_files_of_earlier_runs_are_restricted_and_others_left(tmp_path):
    before = os.umask(0)
    os.umask(before)
    for name in ("history.db", "totals.json", "notes.txt"):
        (tmp_path / name).touch(mode=0o666)
        (tmp_path / name).chmod(0o664)
    (tmp_path / "csv").mkdir()
    (tmp_path / "csv").chmod(0o755)
    with restrict_rights(tmp_path):
        (tmp_path / "new").touch()
        assert stat.S_IMODE((tmp_path / "new").stat().st_mode) & 0o027 == 0
    modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in tmp_path.iterdir()}
    assert modes["history.db"] == modes["totals.json"] == 0o660
    assert modes["csv"] == 0o750
    assert modes["notes.txt"] == 0o664
    assert os.umask(before) == before


def test_a_narrower_umask_is_kept(tmp_path):
    before = os.umask(0o077)
    try:
        with restrict_rights(tmp_path):
            (tmp_path / "new").touch()
        assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o600
    finally:
        os.umask(before)


NO_DATABASE = b"this is no database, but long enough to look at" * 30


@pytest.mark.thorough
@pytest.mark.parametrize("content", list_cases([NO_DATABASE, b"\xa5" * 9000], [NO_DATABASE]))
def test_a_damaged_users_database_does_not_stop_measuring(run, plant, content):
    data = plant.parent / "data"
    data.mkdir()
    (data / "users.db").write_bytes(content)
    code, out, err = run("run", plant)
    text = "\n".join(err)
    assert code == 0, text
    assert "2 records" in out
    assert "Traceback" not in text
    assert "no user database" in text and "restore it from a backup" in text
    assert (data / "users.db").read_bytes() == content
    code, _, err = run("run", "--check", plant)
    assert code == 2
    assert "users.db: no user database" in err[-1]
