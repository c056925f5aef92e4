"""Lists of an archive's members, and reading of one member by its range, wherever the archive lies."""

from __future__ import annotations

import zlib
from collections import OrderedDict
from functools import partial
from threading import Lock

from beltscape.core.errors import InputError
from beltscape.reprocessing.recordings.archives.gzip_stream import GzipStream
from beltscape.reprocessing.recordings.archives.member import Member, split_member
from beltscape.reprocessing.recordings.archives.tar_archive import UnpackedFile, list_tar
from beltscape.reprocessing.recordings.archives.zip_archive import list_zip, read_zip_member
from beltscape.reprocessing.recordings.storage import (
    LARGEST_BYTES,
    measure_size,
    open_file,
    read_bytes,
)

KINDS = {".zip": "zip", ".tar": "tar", ".tar.gz": "tar", ".tgz": "tar"}
"""End of an archive's name → kind of archive."""
_GZIP = b"\x1f\x8b"
_OPEN = 2
"""Compressed archives whose state is kept per process, each up to about 80 MB."""
_STREAMS: OrderedDict[str, GzipStream | None] = OrderedDict()
_LOCK = Lock()


def list_archive(kind: str, url: str) -> dict[str, Member]:
    """Return the files of an archive by name.

    Raises
    ------
    InputError
        When the archive is damaged, cut short, encrypted or cannot be read.
    UnreachableError
        When its store does not answer.
    """
    with _LOCK:
        _STREAMS.pop(url, None)  # the archive may have been replaced since
    stream = _open_stream(url) if kind == "tar" else None
    if stream is not None:
        return list_tar(UnpackedFile(stream), url)
    with open_file(url) as file:
        return list_zip(file, url) if kind == "zip" else list_tar(file, url)


def read_member(kind: str, url: str, path: str, name: str) -> bytes:
    """Return the bytes of a member by its path with range; ``name`` is that for messages.

    Raises
    ------
    InputError
        When the member is damaged or too large, or the archive cannot be read.
    UnreachableError
        When its store does not answer.
    """
    _, start, length = split_member(path)
    if length > LARGEST_BYTES:
        raise InputError(f"{name}: larger than {LARGEST_BYTES >> 20} MiB; no image or table is so large")
    if kind == "zip":
        return read_zip_member(partial(read_bytes, url), start, length, name)
    stream = _open_stream(url)
    try:
        data = (
            read_bytes(url, start, start + length) if stream is None else stream.read(start, start + length)
        )
    except (zlib.error, EOFError) as error:
        raise InputError(
            f"{name}: the file is damaged in its archive ({error}); copy the archive again"
        ) from error
    if len(data) < length:
        raise InputError(f"{name}: the archive has changed or is cut short; copy it again")
    return data


def _open_stream(url: str) -> GzipStream | None:
    """Return the unpacking stream of a compressed archive; None for one that is not compressed."""
    with _LOCK:
        if url not in _STREAMS:
            is_packed = read_bytes(url, 0, len(_GZIP)) == _GZIP
            _STREAMS[url] = GzipStream(partial(read_bytes, url), measure_size(url)) if is_packed else None
        _STREAMS.move_to_end(url)
        while len(_STREAMS) > _OPEN:
            _STREAMS.popitem(last=False)
        return _STREAMS[url]
