"""Archives: damaged, cut short, unsafe or encrypted ones, and those that other programs write."""

from __future__ import annotations

import gzip
import io
import random
import tarfile
import zipfile
import zlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import InputError
from beltscape.reprocessing.recordings.archives import GzipStream, normalise_name
from tests.reprocessing.recordings.captures import NAME, assert_equal_frames, copy, find, pack, read, replay


@pytest.mark.parametrize("kind", ["zip", "tar", "tar.gz"])
@pytest.mark.parametrize("kept", [0, 1, 100, 0.5, 0.9, 0.999])
def test_an_archive_cut_short_is_named_and_the_others_are_found(
    tmp_path: Path, recorded: Path, kind: str, kept: float
) -> None:
    copy(recorded, tmp_path / NAME)
    archive = pack(recorded, tmp_path / f"day.{kind}", "000200-20261123T000000Z")
    data = archive.read_bytes()
    archive.write_bytes(data[: int(kept * len(data)) if isinstance(kept, float) else kept])
    if kind == "tar" and kept == 0.999:  # only in the zeros after the end mark
        archive.write_bytes(data[: len(data) - data[::-1].index(data.rstrip(b"\0")[-1]) - 200])
    recordings, unreadable, _ = find(tmp_path)
    assert [one.name for one in recordings] == [NAME]
    assert [one.name for one in unreadable] == [archive.name]
    assert unreadable[0].reason.startswith(f"{archive}: the archive is damaged or cut short (")
    assert unreadable[0].reason.endswith("; copy it again")
    with pytest.raises(InputError, match="no recording that can be read; day"):
        find(archive)


def test_a_tar_cut_between_two_members_is_no_whole_archive(tmp_path: Path, recorded: Path) -> None:
    archive = pack(recorded, tmp_path / "day.tar", NAME)
    with tarfile.open(archive) as packed:
        member = packed.getmembers()[-4]
    archive.write_bytes(archive.read_bytes()[: member.offset])
    with pytest.raises(InputError, match="cut short"):
        find(archive)


@pytest.mark.parametrize("kind", ["zip", "tar", "tar.gz"])
def test_flipped_bytes_never_end_in_another_error_nor_in_other_images(
    tmp_path: Path, recorded: Path, kind: str
) -> None:
    sound = pack(recorded, tmp_path / f"day.{kind}", NAME).read_bytes()
    wanted, _ = replay(recorded)
    dice = random.Random(28)
    for _ in range(12):
        data = bytearray(sound)
        for _ in range(3):
            data[dice.randrange(len(data))] = dice.randrange(256)
        archive = tmp_path / f"day.{kind}"
        archive.write_bytes(data)
        try:
            (recording,), _, _ = find(archive)
        except InputError:
            continue
        for frame, whole in zip(read(recording)[0], wanted, strict=False):
            for name, image in frame.images.items():
                assert (image == whole.images[name]).all()


def test_a_compressed_tar_with_a_wrong_checksum_is_refused(tmp_path: Path, recorded: Path) -> None:
    archive = pack(recorded, tmp_path / "day.tgz")
    data = bytearray(archive.read_bytes())
    data[-8] ^= 1
    archive.write_bytes(data)
    with pytest.raises(InputError, match=r"damaged or cut short .*incorrect data check"):
        find(archive)


def test_members_that_would_leave_the_archive_are_left_out(tmp_path: Path, recorded: Path) -> None:
    archive = pack(recorded, tmp_path / "day.zip", NAME)
    with zipfile.ZipFile(archive, "a") as packed:
        for name in ("../../etc/x.png", "/cam0/1.png", "a/../../b", "C:\\windows\\y.png", "d/" * 90 + "z"):
            packed.writestr(name, b"x")
    before = set(tmp_path.rglob("*"))
    recordings, _, warnings = find(archive)
    assert [one.name for one in recordings] == [f"day.zip/{NAME}"]
    assert len(warnings) == 1
    assert "members that would leave the archive's folder are left out: ../../etc/x.png, " in warnings[0]
    assert set(tmp_path.rglob("*")) == before


@given(st.text("/.\\:ab", max_size=12))
def test_a_members_path_stays_below_the_root(name: str) -> None:
    path = normalise_name(name)
    assert path is None or not ({".", "..", ""} & set(path.split("/")) and path)


def test_an_encrypted_zip_and_an_archive_in_an_archive_are_named(tmp_path: Path, recorded: Path) -> None:
    copy(recorded, tmp_path / NAME)
    data = bytearray(pack(recorded, tmp_path / "secret.zip", "other").read_bytes())
    directory = data.rindex(b"PK\x01\x02")
    data[directory + 8] |= 1
    (tmp_path / "secret.zip").write_bytes(data)
    with zipfile.ZipFile(tmp_path / "outer.zip", "w") as packed:
        packed.write(tmp_path / "secret.zip", "inner.zip")
    _, unreadable, _ = find(tmp_path)
    reasons = {one.name: one.reason for one in unreadable}
    assert set(reasons) == {"secret.zip", "outer.zip/inner.zip"}
    assert "pack it without a password" in reasons["secret.zip"]
    assert "unpack the outer one" in reasons["outer.zip/inner.zip"]


def test_zips_that_were_streamed_or_hold_backslashes_are_read(tmp_path: Path, recorded: Path) -> None:
    class Pipe(io.BytesIO):
        def seekable(self) -> bool:
            return False

    pipe = Pipe()
    with zipfile.ZipFile(pipe, "w", zipfile.ZIP_DEFLATED) as packed:
        for path in sorted(recorded.rglob("*.*")):
            info = zipfile.ZipInfo("x/" + path.relative_to(recorded).as_posix())
            info.filename = info.filename.replace("/", "\\")
            info.extra = b"\x99\x99\x00\x08" + bytes(2048)
            packed.writestr(info, path.read_bytes(), zipfile.ZIP_DEFLATED)
    (tmp_path / "day.zip").write_bytes(pipe.getvalue())
    (recording,), _, _ = find(tmp_path)
    assert recording.name == "day.zip/x"
    assert_equal_frames(read(recording)[0], replay(recorded)[0])


def test_tars_with_hard_links_and_a_misleading_name_are_read(tmp_path: Path, recorded: Path) -> None:
    folder = copy(recorded, tmp_path / "in" / NAME)
    (folder / "cam1/000004.png").unlink()
    (folder / "cam1/000004.png").hardlink_to(folder / "cam0/000000.png")
    archive = pack(folder, tmp_path / "day.tar.gz").rename(tmp_path / "day.tar")
    (recording,), _, _ = find(archive)
    assert_equal_frames(read(recording)[0], replay(folder)[0])


def test_a_replaced_archive_is_listed_anew(tmp_path: Path, recorded: Path) -> None:
    archive = pack(recorded, tmp_path / "day.tar.gz", "a")
    find(archive)
    pack(recorded, archive, "another")
    (recording,), _, _ = find(archive)
    assert recording.name == "day.tar.gz/another"
    assert_equal_frames(read(recording)[0], replay(recorded)[0])


@pytest.mark.parametrize("streams", [1, 3])
def test_a_gzip_stream_gives_any_range_and_unpacks_what_follows_once(streams: int) -> None:
    dice = random.Random(streams)
    plain = dice.randbytes(3 << 20) + bytes(1 << 20) + dice.randbytes(1 << 20)
    third = len(plain) // streams + 1
    packed = b"".join(gzip.compress(plain[k * third : (k + 1) * third], 1) for k in range(streams)) + bytes(
        512
    )
    fetched: list[int] = []

    def fetch(start: int, end: int) -> bytes:
        fetched.append(start)
        return packed[start:end]

    stream = GzipStream(fetch, len(packed))
    for _ in range(40):
        start = dice.randrange(len(plain) + 1000)
        end = start + dice.randrange(200_000)
        assert stream.read(start, end) == plain[start:end]
    assert stream.read(0, len(plain) + 99) == plain
    fetched.clear()
    for start in range(0, len(plain), 100_000):
        stream.read(start, start + 100_000)
    assert len(fetched) <= len(packed) / (1 << 20) + 2


def test_a_gzip_stream_that_is_damaged_or_cut_short_is_refused() -> None:
    plain = random.Random(1).randbytes(300_000)
    packed = gzip.compress(plain)
    with pytest.raises(EOFError):
        GzipStream(lambda start, end: packed[:-9][start:end], len(packed) - 9).read(0, len(plain) + 1)
    wrong = packed[:-8] + bytes(8)
    with pytest.raises(zlib.error):
        GzipStream(lambda start, end: wrong[start:end], len(wrong)).read(0, len(plain) + 1)
