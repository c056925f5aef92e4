"""Atomic writing of files: whole or unchanged."""

from __future__ import annotations

import pytest

from beltscape.core.errors import OutputError
from beltscape.files.atomic import (
    atomic_replacement,
    ensure_output_folder,
    make_folder_once,
    write_bytes,
    write_text,
)
from beltscape.files.json_text import read_json, write_json


def test_text_is_utf_8_with_plain_line_ends(tmp_path):
    write_text(tmp_path / "a" / "b.txt", "σ\n")
    assert (tmp_path / "a" / "b.txt").read_bytes() == "σ\n".encode()


def test_a_file_name_that_is_no_utf_8_comes_back_from_json(tmp_path):
    write_json(tmp_path / "a.json", {"capture": "caf\udce9"})
    assert read_json(tmp_path / "a.json") == {"capture": "caf\udce9"}


def test_a_file_is_replaced_whole(tmp_path):
    path = tmp_path / "rig.json"
    path.write_bytes(b"old" * 100)
    write_bytes(path, b"new")
    assert path.read_bytes() == b"new"
    assert [p.name for p in tmp_path.iterdir()] == ["rig.json"]


@pytest.mark.parametrize("error", [ValueError("broke"), KeyboardInterrupt()])
def test_exception_leaves_the_old_file_unchanged(tmp_path, error):
    path = tmp_path / "rig.json"
    path.write_text("old")
    with pytest.raises(type(error)), atomic_replacement(path) as temporary:
        temporary.write_text("half")
        raise error
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["rig.json"]


def test_full_disk_is_reported_in_one_line(tmp_path):
    with pytest.raises(OutputError) as error, atomic_replacement(tmp_path / "cloud.ply") as temporary:
        temporary.write_text("half")
        raise OSError(28, "No space left on device")
    assert str(error.value).startswith(f"{tmp_path}/cloud.ply: the disk is full (")
    assert "free some space" in str(error.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("below", ["rig.json", "deep/er/rig.json"])
def test_a_file_where_a_folder_is_needed_is_named(tmp_path, below):
    (tmp_path / "file").write_text("here")
    path = tmp_path / "file" / below
    with pytest.raises(OutputError) as error:
        write_text(path, "text")
    assert str(error.value) == (
        f"{path}: cannot be written ({tmp_path}/file is a file, not a folder); choose another output folder"
    )
    assert (tmp_path / "file").read_text() == "here"


@pytest.mark.parametrize("below", [".", "deeper"])
def test_output_folder_is_checked_before_the_work(tmp_path, below):
    (tmp_path / "file").write_text("here")
    path = tmp_path / "file" / below
    with pytest.raises(OutputError) as error:
        ensure_output_folder(path)
    assert str(error.value) == (
        f"{path}: cannot be written ({tmp_path}/file is a file, not a folder); choose another output folder"
    )


def test_an_output_folder_is_made_and_left_empty(tmp_path):
    assert ensure_output_folder(tmp_path / "a" / "b") == tmp_path / "a" / "b"
    assert list((tmp_path / "a" / "b").iterdir()) == []
    ensure_output_folder(tmp_path / "a" / "b")


def test_a_folder_is_made_as_a_whole_or_not_at_all_and_once(tmp_path):
    made: list[int] = []

    def make(folder, *, fails):
        write_text(folder / "a.txt", "a")
        if fails:
            raise KeyboardInterrupt
        made.append(len(list(folder.iterdir())))

    with pytest.raises(KeyboardInterrupt):
        make_folder_once(tmp_path / "plant", lambda folder: make(folder, fails=True))
    assert not (tmp_path / "plant").exists()
    for _ in range(2):
        make_folder_once(tmp_path / "plant", lambda folder: make(folder, fails=False))
    assert made == [1]
    assert [path.name for path in tmp_path.iterdir()] == ["plant"]
