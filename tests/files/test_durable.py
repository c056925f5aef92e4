"""State on the disk: written durably, read back, set aside where it is damaged."""

from __future__ import annotations

import errno
import json
import os
import stat
from pathlib import Path

import pytest

from beltscape.core.errors import InputError, OutputError
from beltscape.files import atomic
from beltscape.files.atomic import describe_refusal, keep_state, move_aside, read_state
from tests.files.damages import DAMAGES, check_set_aside


def read(path: Path) -> list[str]:
    found, trouble = read_state(path, lambda data: json.loads(data)["number"], "it begins anew")
    assert found is None
    return [trouble] if trouble else []


def test_content_and_name_are_on_the_disk_before_it_returns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    sync, replace = os.fsync, Path.replace

    def note_sync(file: int) -> None:
        calls.append("sync folder" if stat.S_ISDIR(os.fstat(file).st_mode) else "sync file")
        sync(file)

    def note_replace(self: Path, target: Path) -> Path:
        calls.append("rename")
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", note_sync)
    monkeypatch.setattr(Path, "replace", note_replace)
    keep_state(tmp_path / "state.json", b'{"number": 3}')
    assert calls == ["sync file", "rename", "sync folder"]
    assert read_state(tmp_path / "state.json", json.loads, "") == ({"number": 3}, "")
    assert [one.name for one in tmp_path.iterdir()] == ["state.json"]


def test_a_file_that_is_not_there_is_no_trouble(tmp_path: Path) -> None:
    assert read_state(tmp_path / "state.json", json.loads, "it begins anew") == (None, "")


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_named_and_set_aside(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "state.json"
    if damage == "other":
        return
    check_set_aside(path, DAMAGES[damage], lambda: read(path))
    check_set_aside(path, DAMAGES[damage], lambda: read(path))  # in the same second: both are kept
    assert len(list((tmp_path / "damaged").rglob("state.json"))) == 2


def test_a_folder_of_its_name_is_set_aside_and_the_reason_is_named(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    path.mkdir()
    (message,) = read(path)
    assert "cannot be read (Is a directory)" in message and message.endswith("; it begins anew")
    keep_state(path, b"{}")

    def refuse(_: bytes) -> None:
        raise InputError(f"{path}: its content contradicts its sha256")

    message = read_state(path, refuse, "it begins anew")[1]
    assert message.startswith(f"{path}: its content contradicts its sha256 and was moved to ")


def test_one_that_cannot_be_moved_stops_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "state.json"
    path.write_bytes(b"")

    def refuse(*_: object) -> Path:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(atomic, "move_aside", refuse)
    (message,) = read(path)
    assert message == f"{path}: is empty and cannot be moved away (No space left on device); it begins anew"


def test_files_that_belong_together_stay_together(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    for name in ("history.db-wal", "history.db"):
        (tmp_path / name).write_bytes(name.encode())
    moved = move_aside(path, ("-wal", "-shm"))
    (tmp_path / "history.db-wal").write_bytes(b"another")  # its database is gone
    again = move_aside(path, ("-wal", "-shm"))
    assert (
        moved.read_bytes() == b"history.db"
        and moved.with_name("history.db-wal").read_bytes() == b"history.db-wal"
    )
    assert again.parent != moved.parent and again.with_name("history.db-wal").read_bytes() == b"another"


@pytest.mark.parametrize(
    ("code", "fix"),
    [
        (errno.ENOSPC, "the disk is full; free some space"),
        (errno.EDQUOT, "the disk is full; free some space"),
        (errno.EROFS, "the file system is read-only; mount it writable"),
        (errno.EACCES, "correct the rights of file and folder"),
        (errno.EIO, "check its disk"),
    ],
)
def test_the_fix_follows_the_cause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, fix: str
) -> None:
    assert fix in describe_refusal(OSError(code, os.strerror(code)))

    def refuse(_: int) -> None:
        raise OSError(code, os.strerror(code))

    path = tmp_path / "state.json"
    path.write_bytes(b"before")
    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(OutputError, match=fix):
        keep_state(path, b"after")
    assert path.read_bytes() == b"before" and [one.name for one in tmp_path.iterdir()] == ["state.json"]
