"""Recordings in S3-compatible storage, served by moto in this process; stores that are away or silent."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from beltscape.core.errors import InputError
from beltscape.core.progress import Silent
from beltscape.reprocessing.recordings.recording import FrameReader
from beltscape.reprocessing.recordings.storage import UnreachableError
from tests.reprocessing.recordings.captures import (
    CAMERAS,
    NAME,
    assert_equal_frames,
    find,
    pack,
    read,
    replay,
    write_capture,
)

pytest.importorskip("moto", reason="S3 tests need moto: pip install 'moto[s3]' flask flask-cors")
pytest.importorskip("s3fs", reason="pip install 'beltscape[cluster]'")
QUICK = {"connect_timeout": 1, "read_timeout": 1, "retries": {"max_attempts": 0}}


@pytest.fixture(scope="module")
def store() -> Iterator[str]:
    """Address of an empty S3 server, which the environment names as a user's would."""
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer("127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("AWS_ACCESS_KEY_ID", "key")
        environment.setenv("AWS_SECRET_ACCESS_KEY", "secret")
        environment.setenv("AWS_DEFAULT_REGION", "us-east-1")
        environment.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        yield f"http://{host}:{port}"
    server.stop()


@pytest.fixture(scope="module")
def bucket(store: str, recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A bucket with a capture, two archives and a damaged one."""
    import s3fs

    folder = tmp_path_factory.mktemp("bucket")
    other = write_capture(folder / "other", seed=7, frames=3)
    file_system = s3fs.S3FileSystem()
    file_system.mkdir("plant7")
    file_system.put(str(recorded), f"plant7/2026/ring/{NAME}", recursive=True)
    for name in ("a.zip", "b.tar", "c.tgz"):
        file_system.put_file(str(pack(other, folder / name, name)), f"plant7/2026/{name}")
    file_system.pipe_file("plant7/2026/d.zip", (folder / "a.zip").read_bytes()[:5000])
    return "s3://plant7"


def test_a_bucket_is_read_as_the_folder(bucket: str, recorded: Path) -> None:
    recordings, unreadable, warnings = find(f"{bucket}/2026/")
    assert [one.name for one in recordings] == ["a.zip/a.zip", "b.tar/b.tar", "c.tgz/c.tgz", f"ring/{NAME}"]
    assert [(one.name, one.reason.split(" (")[0]) for one in unreadable] == [
        ("d.zip", f"{bucket}/2026/d.zip: the archive is damaged or cut short")
    ]
    assert warnings == []
    assert_equal_frames(read(recordings[-1])[0], replay(recorded)[0])
    first = read(recordings[0])[0]
    assert len(first) == 3
    for other in recordings[1:3]:
        assert_equal_frames(read(other)[0], first)


def test_the_digest_is_of_the_objects_content(bucket: str, recorded: Path) -> None:
    import s3fs

    address = f"{bucket}/2026/ring/{NAME}"
    before = find(address)[0][0].digest
    file_system, path = s3fs.S3FileSystem(), f"plant7/2026/ring/{NAME}/cam0/000000.png"
    file_system.pipe_file(path, (recorded / "cam0/000000.png").read_bytes())
    assert find(address)[0][0].digest == before
    file_system.pipe_file(path, (recorded / "cam0/000001.png").read_bytes())
    assert find(address)[0][0].digest != before
    file_system.pipe_file(path, (recorded / "cam0/000000.png").read_bytes())


def test_a_bucket_or_folder_that_is_not_there_is_named(bucket: str) -> None:
    for address in ("s3://nowhere", "s3://nowhere/2026", f"{bucket}/2027", f"{bucket}/2026/none.zip"):
        with pytest.raises(InputError, match=f"{address}: no such file, folder or bucket; check the address"):
            find(address)


def test_a_store_that_is_away_or_silent_is_named_soon(bucket: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from fsspec.config import conf

    with socket.create_server(("127.0.0.1", 0)) as silent, socket.create_server(("127.0.0.1", 0)) as closed:
        ports = [silent.getsockname()[1], closed.getsockname()[1]]
        closed.close()
        for port in ports:
            own = {"endpoint_url": f"http://127.0.0.1:{port}", "config_kwargs": QUICK}
            monkeypatch.setitem(conf, "s3", own)
            monkeypatch.setattr("s3fs.core.S3FileSystem.retries", 1)
            start = time.monotonic()
            with pytest.raises(
                UnreachableError, match=r"s3://plant7/2026: does not answer \(.*check address, network"
            ):
                find(f"{bucket}/2026")
            assert time.monotonic() - start < 10


def test_a_store_that_goes_away_while_it_is_read_costs_no_image(
    bucket: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from fsspec.config import conf

    (recording,), _, _ = find(f"{bucket}/2026/ring")
    frames = FrameReader(recording.place, CAMERAS, Silent()).read(recording.frames * 3)
    next(frames)
    monkeypatch.setattr("s3fs.core.S3FileSystem.retries", 1)
    monkeypatch.setitem(conf, "s3", {"endpoint_url": "http://127.0.0.1:9", "config_kwargs": QUICK})
    with pytest.raises(UnreachableError, match="does not answer"):
        list(frames)
