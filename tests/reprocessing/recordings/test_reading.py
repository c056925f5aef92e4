"""Frame sets that a worker reads are those of a replay, from folders and archives, also with faults."""

from __future__ import annotations

import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.progress import Silent
from beltscape.files.images import write_image
from beltscape.reprocessing.recordings.recording import FrameReader
from beltscape.reprocessing.recordings.storage import UnreachableError
from tests.reprocessing.recordings.captures import (
    CAMERAS,
    NAME,
    assert_equal_frames,
    copy,
    find,
    pack,
    read,
    replay,
)

ARCHIVES = ("day.zip", "day.tar", "day.tar.gz", "day.tgz")


def cut_short(folder: Path) -> None:
    path = folder / "cam1/000001.png"
    path.write_bytes(path.read_bytes()[:-500])


def empty(folder: Path) -> None:
    (folder / "cam0/000002.png").write_bytes(b"")


def wrong_size(folder: Path) -> None:
    write_image(folder / "cam2/000003.png", np.zeros((20, 30), np.uint8))


def no_image(folder: Path) -> None:
    (folder / "cam2/000004.png").write_text("nothing")


def missing_image(folder: Path) -> None:
    (folder / "cam1/000000.png").unlink()


def missing_instant(folder: Path) -> None:
    for name in CAMERAS:
        (folder / name / "000002.png").unlink()


def missing_camera(folder: Path) -> None:
    for path in (folder / "cam2").iterdir():
        path.unlink()


def missing_row(folder: Path) -> None:
    lines = (folder / "encoder.csv").read_text().splitlines()
    (folder / "encoder.csv").write_text("\n".join([*lines[:3], *lines[4:]]) + "\n")


def other_camera(folder: Path) -> None:
    write_image(folder / "cam9/000077.png", np.zeros((20, 30), np.uint8))


def hidden_image(folder: Path) -> None:
    (folder / "cam0/.000009.png.part").write_bytes(b"half")
    (folder / "cam0/.000009.png").write_bytes(b"half")


def rgb(folder: Path) -> None:
    image = np.random.default_rng(4).integers(0, 65535, (256, 306, 3), np.uint16)
    (folder / "cam1/000001.png").unlink()
    write_image(folder / "cam1/000001.tif", image)


FAULTS = (
    cut_short, empty, wrong_size, no_image, missing_image, missing_instant, missing_camera, missing_row, other_camera,
    hidden_image, rgb,
)  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_a_recording_reads_as_its_replay_with_the_same_warnings(
    tmp_path: Path, recorded: Path, fault: Callable[[Path], None]
) -> None:
    folder = copy(recorded, tmp_path / NAME)
    fault(folder)
    (recording,), unreadable, found_warnings = find(folder)
    frames, read_warnings = read(recording)
    wanted, warnings = replay(folder)
    assert_equal_frames(frames, wanted)
    assert sorted(found_warnings + read_warnings) == sorted(warnings)
    assert unreadable == []


@pytest.mark.parametrize("archive", ARCHIVES)
def test_archives_read_as_the_folder_with_warnings_of_the_same_text(
    tmp_path: Path, recorded: Path, archive: str
) -> None:
    folder = copy(recorded, tmp_path / "folder" / NAME)
    for fault in FAULTS:
        if fault not in (missing_camera, hidden_image, no_image):
            fault(folder)
    (recording,), _, found_warnings = find(pack(folder, tmp_path / archive, f"ring/{NAME}"))
    assert recording.name == f"{archive}/ring/{NAME}"
    frames, read_warnings = read(recording)
    wanted, warnings = replay(folder)
    assert_equal_frames(frames, wanted)
    here = str(tmp_path / archive / "ring")
    assert sorted(found_warnings + read_warnings) == sorted(
        line.replace(str(tmp_path / "folder"), here) for line in warnings
    )


@pytest.mark.parametrize(("with_positions", "frames_per_s"), [(False, None), (False, 4.0), (True, 4.0)])
def test_times_come_from_the_same_place_as_those_of_a_replay(
    recorded: Path, with_positions: bool, frames_per_s: float | None
) -> None:
    (recording,), _, _ = find(recorded, with_positions=with_positions, frames_per_s=frames_per_s)
    wanted, _ = replay(recorded, with_positions=with_positions, frames_per_s=frames_per_s)
    assert_equal_frames(read(recording)[0], wanted)


def test_any_part_is_read_by_another_process_as_by_this_one(tmp_path: Path, recorded: Path) -> None:
    for source in (recorded, pack(recorded, tmp_path / "day.tar.gz")):
        (recording,), _, _ = find(source)
        sent = pickle.loads(pickle.dumps(recording))
        assert sent == recording
        reader = FrameReader(sent.place, CAMERAS, Silent())
        assert_equal_frames(list(reader.read(sent.frames[3:4])), replay(recorded)[0][3:4])


def test_bytes_and_seconds_of_reading_are_counted(recorded: Path) -> None:
    (recording,), _, _ = find(recorded)
    reader = FrameReader(recording.place, CAMERAS, Silent())
    assert len(list(reader.read(recording.frames))) == len(recording.frames)
    assert reader.read_bytes == sum(path.stat().st_size for path in recorded.glob("cam*/*.png"))
    assert reader.read_s > 0
    assert reader.decode_s > 0


def test_few_frames_are_read_ahead_and_every_file_once(
    recorded: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from beltscape.reprocessing.recordings import recording as reading

    decoded: list[str] = []
    original = reading.decode_image
    monkeypatch.setattr(
        reading, "decode_image", lambda data, name: decoded.append(name) or original(data, name)
    )
    (recording,), _, _ = find(recorded)
    frames = FrameReader(recording.place, CAMERAS, Silent()).read(recording.frames[:1] * 40)
    next(frames)
    frames.close()  # type: ignore[attr-defined]
    assert len(decoded) <= 4 * len(CAMERAS)
    decoded.clear()
    read(recording)
    assert sorted(decoded) == sorted(map(str, recorded.glob("cam*/*.png")))


def test_a_place_that_this_machine_does_not_see_is_no_missing_image(tmp_path: Path, recorded: Path) -> None:
    for source in (copy(recorded, tmp_path / NAME), pack(recorded, tmp_path / "day.zip")):
        (recording,), _, _ = find(source)
        source.rename(source.with_suffix(".elsewhere"))
        with pytest.raises(UnreachableError, match="is not there on this machine"):
            read(recording)


def test_an_image_removed_after_the_search_is_named_and_left_out(tmp_path: Path, recorded: Path) -> None:
    folder = copy(recorded, tmp_path / NAME)
    (recording,), _, _ = find(folder)
    (folder / "cam1/000001.png").unlink()
    frames, warnings = read(recording)
    assert list(frames[1].images) == ["cam0", "cam2"]
    assert warnings == [
        f"{folder}/cam1/000001.png: cannot be read (No such file or directory); going on without this image"
    ]


def test_a_wrong_checksum_in_a_zip_costs_one_image(tmp_path: Path, recorded: Path) -> None:
    archive = pack(recorded, tmp_path / "day.zip")
    with zipfile.ZipFile(archive) as packed:
        info = packed.getinfo("cam1/000002.png")
    data = bytearray(archive.read_bytes())
    data[info.header_offset + 3000] ^= 0xFF
    archive.write_bytes(data)
    (recording,), _, _ = find(archive)
    frames, warnings = read(recording)
    assert list(frames[2].images) == ["cam0", "cam2"]
    assert len(warnings) == 1
    assert warnings[0].startswith(f"{archive}/cam1/000002.png: the file is damaged in its archive (")
    assert_equal_frames([*frames[:2], *frames[3:]], [*replay(recorded)[0][:2], *replay(recorded)[0][3:]])
