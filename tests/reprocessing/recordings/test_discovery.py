"""Recordings of a source: what is found under which name, what is skipped, and the digests."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.files.images import write_image
from beltscape.files.output_folder import MANIFEST, STAGING
from beltscape.reprocessing.recordings.capture_files import find_wall_clock
from tests.reprocessing.recordings.captures import NAME, copy, find, pack, read, write_capture

OTHER = "000124-20261122T111500Z-alarm"


@pytest.fixture(scope="module")
def year(tmp_path_factory: pytest.TempPathFactory, recorded: Path) -> Path:
    """A recorder's folder with archives; no test writes into it."""
    root = tmp_path_factory.mktemp("year")
    copy(recorded, root / "ring" / NAME)
    other = write_capture(root / "all" / OTHER, seed=1, frames=2)
    write_capture(root / "kept/cal2", seed=2, frames=2)
    write_capture(root / "kept/cal10", seed=3, frames=2)
    pack(write_capture(root / "tmp/a", seed=4, frames=2).parent, root / "2026-11-21.zip", "plant/ring")
    (root / "deep").mkdir()
    pack(write_capture(root / "tmp/b", seed=5, frames=2), root / "deep/2026-11-22.tgz")
    shutil.rmtree(root / "tmp")
    shutil.copytree(other, root / "all/000125-20261122T121500Z.part")
    (root / ".snapshots").mkdir()
    (root / "notes.txt").write_text("of the plant")
    (root / "day.tar.xz").write_bytes(b"")
    return root


def test_a_tree_of_folders_and_archives_is_found_in_natural_order(year: Path) -> None:
    recordings, unreadable, warnings = find(year)
    names = [
        "2026-11-21.zip/plant/ring/a", f"all/{OTHER}", "deep/2026-11-22.tgz", "kept/cal2", "kept/cal10",
        f"ring/{NAME}",
    ]  # fmt: skip
    assert [one.name for one in recordings] == names
    assert [one.name for one in unreadable] == ["all/000125-20261122T121500Z.part", "day.tar.xz"]
    assert "recorder" in unreadable[0].reason
    assert "pack it as .zip" in unreadable[1].reason
    assert warnings == [f"{year}: hidden files and folders are left out: .snapshots"]


def test_a_source_that_is_one_capture_or_one_archive_has_its_own_name(year: Path) -> None:
    assert [one.name for one in find(year / "ring" / NAME)[0]] == [NAME]
    assert [one.name for one in find(f"{year}/2026-11-21.zip")[0]] == ["2026-11-21.zip/plant/ring/a"]
    inner = f"zip://plant/ring::{year}/2026-11-21.zip"
    assert [one.name for one in find(inner)[0]] == ["2026-11-21.zip/a"]
    assert [one.name for one in find(f"file://{year}/deep/2026-11-22.tgz")[0]] == ["2026-11-22.tgz"]


def test_the_recorders_wall_clock_is_that_of_the_name(year: Path) -> None:
    clocks = {one.name: one.start_wall_ns for one in find(year)[0]}
    assert clocks[f"ring/{NAME}"] == 1795342500 * 10**9
    assert clocks[f"all/{OTHER}"] == (1795342500 + 3600) * 10**9
    assert clocks["kept/cal2"] is None
    assert find_wall_clock("000001-20261322T101500Z") is None


def test_frames_are_in_the_order_of_time_with_positions(recorded: Path) -> None:
    (recording,), _, _ = find(recorded)
    assert [one.frame for one in recording.frames] == [f"{k:06d}" for k in range(5)]
    assert [one.position_mm for one in recording.frames] == [1000.5 + 61.25 * k for k in range(5)]
    assert recording.frames[0].files == {f"cam{k}": f"cam{k}/000000.png" for k in range(3)}


def test_the_same_recording_in_a_folder_and_an_archive_is_counted_once(
    tmp_path: Path, recorded: Path
) -> None:
    folder = copy(recorded, tmp_path / "ring" / NAME)
    pack(folder, tmp_path / "day.zip", NAME)
    pack(folder, tmp_path / f"{NAME}.tar")
    recordings, unreadable, _ = find(tmp_path)
    assert [one.name for one in recordings] == [f"ring/{NAME}"]
    assert [one.name for one in unreadable] == [f"{NAME}.tar", f"day.zip/{NAME}"]
    assert all(f"is the same recording as ring/{NAME} (" in one.reason for one in unreadable)


def test_of_two_copies_that_with_more_images_is_kept(tmp_path: Path, recorded: Path) -> None:
    folder = copy(recorded, tmp_path / "ring" / NAME)
    pack(folder, tmp_path / "day.zip", NAME)
    (folder / "cam1/000002.png").unlink()
    assert [one.name for one in find(tmp_path)[0]] == [f"day.zip/{NAME}"]


def test_a_capture_of_another_start_with_the_same_name_is_another_recording(
    tmp_path: Path, recorded: Path
) -> None:
    copy(recorded, tmp_path / "plant1" / NAME)
    write_capture(tmp_path / "plant2" / NAME, seed=9)
    assert len(find(tmp_path)[0]) == 2


@pytest.mark.parametrize("archive", ["", "day.zip", "day.tar", "day.tgz"])
@pytest.mark.parametrize("changed", ["cam2/000003.png", "encoder.csv", "exposures.csv"])
def test_the_digest_changes_with_any_file_and_only_then(
    tmp_path: Path, recorded: Path, archive: str, changed: str
) -> None:
    folder = copy(recorded, tmp_path / "copy")
    source = pack(folder, tmp_path / archive) if archive else folder
    before = find(source)[0][0].digest
    assert find(source)[0][0].digest == before
    path = folder / changed
    path.write_bytes(path.read_bytes() + (b"\n" if changed.endswith("csv") else b""))
    os.utime(path, ns=(path.stat().st_mtime_ns, path.stat().st_mtime_ns + 10**9))
    if archive:
        source = pack(folder, tmp_path / archive)
    assert find(source)[0][0].digest != before


def test_an_archive_whose_bytes_were_repaired_has_another_digest(tmp_path: Path, recorded: Path) -> None:
    archive = pack(recorded, tmp_path / "day.zip")
    sound = archive.read_bytes()
    archive.write_bytes(sound[:5000] + bytes(100) + sound[5100:])
    damaged = find(archive)[0][0].digest
    archive.write_bytes(sound)
    assert find(archive)[0][0].digest != damaged


def test_unfinished_outputs_are_named(tmp_path: Path, recorded: Path) -> None:
    copy(recorded, tmp_path / NAME)
    for name in ("a", "b", "c"):
        write_capture(tmp_path / name, seed=ord(name), frames=2)
    (tmp_path / "a" / STAGING).mkdir()
    manifest = {
        "format": "beltscape-output/1",
        "command": "simulate",
        "version": "1",
        "complete": False,
        "files": [],
    }
    (tmp_path / "b" / MANIFEST).write_text(json.dumps(manifest))
    (tmp_path / "c" / MANIFEST).write_text(json.dumps({**manifest, "complete": True}))
    recordings, unreadable, _ = find(tmp_path)
    assert [one.name for one in recordings] == [NAME, "c"]
    assert [one.name for one in unreadable] == ["a", "b"]
    assert all("interrupted" in one.reason and "run it again" in one.reason for one in unreadable)


def test_captures_that_cannot_be_measured_are_named_and_the_others_found(
    tmp_path: Path, recorded: Path
) -> None:
    copy(recorded, tmp_path / NAME)
    faults = {
        "damaged": ("encoder.csv", "frame,timestamp_s,belt_position_mm\n000000,x,1\n", "line 2: timestamp_s 'x'"),
        "foreign": ("encoder.csv", "frame,timestamp_s,belt_position_mm\n7,1,1\n", "give the encoder.csv of this"),
        "latin": ("encoder.csv", "bändgeschwindigkeit", "not UTF-8 text"),
        "light": ("exposures.csv", "frame,camera,exposure_us\n000000,cam0,-1\n", "exposure_us -1 is not positive"),
        "nul": ("encoder.csv", "\0", "the header is"),
    }  # fmt: skip
    for k, (name, (table, text, _)) in enumerate(faults.items()):
        write_capture(tmp_path / name, seed=20 + k, frames=2)
        (tmp_path / name / table).write_bytes(text.encode("latin-1"))
    write_capture(tmp_path / "alone", seed=30, frames=2, cameras=("cam0",))
    write_capture(tmp_path / "no_core", seed=31, frames=2, cameras=("cam1", "cam2"))
    write_capture(tmp_path / "timeless", seed=32, frames=2)
    (tmp_path / "timeless/encoder.csv").unlink()
    twice = write_capture(tmp_path / "twice", seed=33, frames=2)
    write_image(twice / "cam1/000001.tif", np.zeros((256, 306), np.uint8))
    reasons = {
        **{name: text for name, (_, _, text) in faults.items()}, "alone": "depth needs a second view",
        "no_core": "no images of the core camera cam0", "timeless": "encoder.csv: no such file; the times",
        "twice": "frame 000001 is there twice",
    }  # fmt: skip
    recordings, unreadable, _ = find(tmp_path)
    assert [one.name for one in recordings] == [NAME]
    assert {one.name for one in unreadable} == set(reasons)
    for one in unreadable:
        assert reasons[one.name] in one.reason
        assert "\n" not in one.reason


def test_a_source_without_recordings_is_refused_with_the_fix(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the source is empty; give"):
        find("")
    with pytest.raises(InputError, match="Protocol not known"):
        find("foo://bar")
    with pytest.raises(InputError, match=r"No such file"):
        find(tmp_path / "nowhere")
    with pytest.raises(
        InputError, match=r"no recording in it: .* core camera in cam0/.*give the recorder's folder"
    ):
        find(tmp_path)
    write_image(tmp_path / "x/left/1.png", np.zeros((20, 30), np.uint8))
    with pytest.raises(InputError, match=r"x/left has images, but is no camera of the rig"):
        find(tmp_path)
    (tmp_path / "file.txt").write_text("")
    with pytest.raises(InputError, match="is a file; give a folder, or an archive"):
        find(tmp_path / "file.txt")


def test_links_that_lead_back_end_and_links_to_captures_count_once(tmp_path: Path, recorded: Path) -> None:
    folder = copy(recorded, tmp_path / "ring" / NAME)
    (tmp_path / "ring/up").symlink_to(tmp_path)
    (tmp_path / "today").mkdir()
    (tmp_path / "today" / NAME).symlink_to(folder)
    (tmp_path / "another_name").symlink_to(folder)
    (tmp_path / "broken").symlink_to(tmp_path / "nowhere")
    recordings, unreadable, _ = find(tmp_path)
    assert [one.name for one in recordings] == ["another_name"]
    assert [one.name for one in unreadable] == [f"ring/{NAME}", "ring/up", f"today/{NAME}"]
    assert "is by a link the same folder as another_name; remove the link" in unreadable[0].reason
    assert "is by a link the same folder as the source" in unreadable[1].reason


def test_a_folder_that_may_not_be_listed_is_named(
    tmp_path: Path, recorded: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from fsspec.implementations.local import LocalFileSystem  # pyrefly: ignore[missing-import]

    copy(recorded, tmp_path / NAME)
    (tmp_path / "locked").mkdir()
    original = LocalFileSystem.ls

    def ls(self: LocalFileSystem, path: str, **options: bool) -> object:
        if path.endswith("locked"):  # root, who may run the tests, may list everything
            raise PermissionError(13, "Permission denied", path)
        return original(self, path, **options)

    monkeypatch.setattr(LocalFileSystem, "ls", ls)
    recordings, unreadable, _ = find(tmp_path)
    assert [one.name for one in recordings] == [NAME]
    assert [(one.name, one.reason) for one in unreadable] == [
        ("locked", f"{tmp_path}/locked: cannot be read (Permission denied); give read permission")
    ]


def test_frames_of_an_unknown_length_of_name_are_read_from_memory(recorded: Path) -> None:
    import fsspec

    memory = fsspec.filesystem("memory")
    memory.put(str(recorded), f"/plant/{NAME}", recursive=True)
    try:
        (recording,), _, _ = find("memory://plant")
        assert recording.name == NAME
        assert recording.place.url == f"memory://plant/{NAME}"
        assert sum(len(one.images) for one in read(recording)[0]) == 15
    finally:
        memory.rm("/plant", recursive=True)
