"""Day archives, zip and tar: lists of their members with byte ranges, and reading of one member by its range.

A member is read without a list of the archive's members, wherever the archive lies. In a gzip stream unpacking goes
on from copies of the inflater's state that were kept on the way.
"""

from __future__ import annotations

import io
import re
import struct
import tarfile
import zipfile
import zlib
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from threading import Lock
from typing import IO, TYPE_CHECKING

from beltscape.core.errors import InputError
from beltscape.reprocessing.recordings.storage import LARGEST_BYTES, measure_size, open_file, read_bytes

if TYPE_CHECKING:
    from zlib import _Decompress as Inflater  # its class has no public name


_RANGE = re.compile(r"(.*)@(\d+)\+(\d+)", re.DOTALL)


@dataclass(frozen=True, slots=True)
class ArchiveMember:
    """A file in an archive."""

    start: int
    """zip: of the local header in the archive; tar: of the data in the archive, in a compressed one when unpacked."""
    length: int
    """Bytes of the range: zip: header, packed data and what follows; tar: the data."""
    size: int
    """Bytes of the unpacked file."""
    stamp: str
    """What tells a changed file: a checksum, or its time."""

    def append_range(self, name: str) -> str:
        """Return the path by which the member is read."""
        return f"{name}@{self.start}+{self.length}"


def split_member(path: str) -> tuple[str, int, int]:
    """Return name, start and length of a path that `ArchiveMember.append_range` made."""
    match = _RANGE.fullmatch(path)
    if match is None:
        raise ValueError(f"{path}: has no byte range")
    return match[1], int(match[2]), int(match[3])


def normalise_name(name: str) -> str | None:
    """Return a member's path with "/" and without "./"; None for one that would leave the archive's root."""
    parts = [part for part in name.replace("\\", "/").split("/") if part != "."]
    if name.startswith(("/", "\\")) or ".." in parts or (parts and parts[0].endswith(":")):
        return None
    return "/".join(part for part in parts if part)


_ZIP_HEADER = struct.Struct("<4sHHHHHIIIHH")
"""Local file header: signature, version, flags, method, time, date, CRC, two sizes, two lengths (APPNOTE 4.3.7)."""
_CRC = struct.Struct("<I")
_ZIP_SIGNATURE, _DESCRIPTOR_SIGNATURE = b"PK\x03\x04", b"PK\x07\x08"
_ENCRYPTED, _DESCRIPTOR = 0x1, 0x8
"""Flags: the data is encrypted; the CRC follows the data (APPNOTE 4.4.4)."""
_ZIP_MARGIN = 1 << 10
"""Bytes read beside the packed data: header, name and CRC; a longer name or extra field costs a second reading."""
_DESCRIPTOR_BYTES = 8
"""Bytes of a data descriptor up to its CRC: the signature, which may be missing, and the CRC (APPNOTE 4.3.9)."""


def list_zip(file: IO[bytes], url: str) -> dict[str, ArchiveMember]:
    """Return the files of a zip archive by name; InputError if it is damaged, encrypted or packed otherwise."""
    try:
        with zipfile.ZipFile(file) as archive:
            infos = [info for info in archive.infolist() if not info.is_dir()]
    except (zipfile.BadZipFile, NotImplementedError, ValueError, struct.error, EOFError) as error:
        raise InputError(f"{url}: the archive is damaged or cut short ({error}); copy it again") from error
    for info in infos:
        if info.flag_bits & _ENCRYPTED:
            raise InputError(f"{url}: the archive is encrypted; pack it without a password")
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise InputError(
                f"{url}: {info.filename} is packed by method {info.compress_type}; pack it again by deflate or store"
            )
    return {
        info.filename: ArchiveMember(
            info.header_offset, info.compress_size, info.file_size, f"{info.CRC:08x}"
        )
        for info in infos
    }


def read_zip_member(read: Callable[[int, int], bytes], start: int, length: int, name: str) -> bytes:
    """Return the unpacked bytes of the member whose local header is at ``start``.

    ``read`` returns the archive's bytes of a range; ``length`` is that of the packed data.

    Raises
    ------
    InputError
        When the header is none, the data does not unpack, or the checksum differs.
    """
    data = read(start, start + length + _ZIP_MARGIN)
    try:
        signature, _, flags, method, _, _, crc, _, _, name_bytes, extra_bytes = _ZIP_HEADER.unpack_from(data)
        begin = _ZIP_HEADER.size + name_bytes + extra_bytes
        end = begin + length
        if len(data) < end + _DESCRIPTOR_BYTES:
            data = read(start, start + end + _DESCRIPTOR_BYTES)
        if flags & _DESCRIPTOR:
            signed = data[end : end + len(_DESCRIPTOR_SIGNATURE)] == _DESCRIPTOR_SIGNATURE
            (crc,) = _CRC.unpack_from(data, end + (len(_DESCRIPTOR_SIGNATURE) if signed else 0))
        unpacked = _unpack(data[begin:end], method)
    except (struct.error, zlib.error) as error:
        raise _damage(name, str(error)) from error
    if signature != _ZIP_SIGNATURE or len(data) < end:
        raise _damage(name, "the archive has changed or is cut short")
    if zlib.crc32(unpacked) != crc:
        raise _damage(name, "wrong checksum")
    return unpacked


def _unpack(packed: bytes, method: int) -> bytes:
    if method == zipfile.ZIP_STORED:
        return packed
    inflater = zlib.decompressobj(-zlib.MAX_WBITS)
    unpacked = inflater.decompress(packed, LARGEST_BYTES)
    if not inflater.eof:
        raise zlib.error(f"cut short, or larger than {LARGEST_BYTES >> 20} MiB")
    return unpacked


def _damage(name: str, reason: str) -> InputError:
    return InputError(f"{name}: the file is damaged in its archive ({reason}); copy the archive again")


_GZIP_WINDOW = zlib.MAX_WBITS | 16
"""Window bits of a gzip stream with its header and checksum (zlib's manual, inflateInit2)."""
_PACKED_BLOCK = 1 << 20
"""Packed bytes that are read at once."""
_BLOCKS = 16
"""Blocks kept: readers of several cameras unpack at as many places of the archive."""
_SLICE = 1 << 16
"""Packed bytes that are fed to the inflater at once: a kept state holds what is left of one slice."""
_SKIP = 1 << 20
"""Unpacked bytes that are made at once where they are only skipped."""
_CHECKPOINTS = 1000
"""Kept states of the whole stream, each about 50 kB: at most 1 / 1000 of it is unpacked again for a jump back."""
_CURSORS = 16
"""States kept behind the last reads: files that follow one another are unpacked once."""


class GzipStream:
    """Reads any range of what a gzip file holds; usable from several threads."""

    def __init__(self, read: Callable[[int, int], bytes], packed_bytes: int) -> None:
        """``read`` returns the packed bytes of a range."""
        self._read, self._packed_bytes = read, packed_bytes
        self._spacing = max(_PACKED_BLOCK, packed_bytes // _CHECKPOINTS)
        self._checkpoints = [_Cursor(zlib.decompressobj(_GZIP_WINDOW), b"", 0, 0)]
        self._recent: OrderedDict[int, _Cursor] = OrderedDict()
        self._blocks: OrderedDict[int, bytes] = OrderedDict()
        self._lock = Lock()

    def read(self, start: int, end: int) -> bytes:
        """Return the unpacked bytes of a range; shorter at the end of the stream.

        Raises
        ------
        zlib.error
            When the packed bytes are damaged.
        EOFError
            When the stream is cut short.
        """
        with self._lock:
            cursor = self._take_cursor(start)
            while cursor.position < start and self._inflate(cursor, min(start - cursor.position, _SKIP)):
                pass
            parts: list[bytes] = []
            while cursor.position < end and (part := self._inflate(cursor, end - cursor.position)):
                parts.append(part)
            self._recent[cursor.position] = cursor
            while len(self._recent) > _CURSORS:
                self._recent.popitem(last=False)
            return b"".join(parts)

    def _take_cursor(self, start: int) -> _Cursor:
        """Return the state that is nearest before ``start``, for the caller alone."""
        recent = max((position for position in self._recent if position <= start), default=-1)
        index = bisect_right(self._checkpoints, start, key=lambda cursor: cursor.position) - 1
        if recent >= self._checkpoints[index].position:
            return self._recent.pop(recent)
        return self._checkpoints[index].copy()

    def _inflate(self, cursor: _Cursor, most: int) -> bytes:
        """Return at least one of the next ``most`` unpacked bytes; empty at the end of the stream."""
        while True:
            if cursor.inflater.eof and not self._begin_next_stream(cursor):
                return b""
            if not cursor.pending and not self._feed(cursor):
                raise EOFError("the compressed stream is cut short")
            part = cursor.inflater.decompress(cursor.pending, most)
            cursor.pending = cursor.inflater.unconsumed_tail
            cursor.position += len(part)
            self._keep_checkpoint(cursor)
            if part:
                return part

    def _begin_next_stream(self, cursor: _Cursor) -> bool:
        """Begin the stream that follows a finished one, as in joined files; return False without one."""
        rest = cursor.inflater.unused_data.lstrip(b"\0")
        while not rest:
            if not self._feed(cursor):
                return False
            rest = cursor.pending.lstrip(b"\0")
        cursor.inflater, cursor.pending = zlib.decompressobj(_GZIP_WINDOW), rest
        return True

    def _feed(self, cursor: _Cursor) -> bool:
        """Take the next slice of packed bytes; False where there is none."""
        block, offset = divmod(cursor.packed, _PACKED_BLOCK)
        cursor.pending = self._read_block(block)[offset : offset + _SLICE]
        cursor.packed += len(cursor.pending)
        return bool(cursor.pending)

    def _read_block(self, block: int) -> bytes:
        if block not in self._blocks:
            start = block * _PACKED_BLOCK
            self._blocks[block] = (
                self._read(start, start + _PACKED_BLOCK) if start < self._packed_bytes else b""
            )
        self._blocks.move_to_end(block)
        while len(self._blocks) > _BLOCKS:
            self._blocks.popitem(last=False)
        return self._blocks[block]

    def _keep_checkpoint(self, cursor: _Cursor) -> None:
        far = cursor.position >= self._checkpoints[-1].position + self._spacing
        if far and not cursor.pending and not cursor.inflater.eof:
            self._checkpoints.append(cursor.copy())


class _Cursor:
    """State of unpacking at one position."""

    __slots__ = ("inflater", "packed", "pending", "position")

    def __init__(self, inflater: Inflater, pending: bytes, packed: int, position: int) -> None:
        self.inflater = inflater
        self.pending = pending
        """Packed bytes that were read and not unpacked yet."""
        self.packed = packed
        """Packed bytes read so far."""
        self.position = position
        """Unpacked bytes so far."""

    def copy(self) -> _Cursor:
        """Return an independent copy."""
        return _Cursor(self.inflater.copy(), self.pending, self.packed, self.position)


_TAR_BLOCK = 512
"""Bytes of a tar's block; an archive ends with blocks of zeros (POSIX.1-2017, pax, ustar interchange format)."""
_CHUNK = 1 << 20
"""Bytes of a stream that are unpacked at once where only its checksum is of interest."""


class UnpackedFile(io.RawIOBase):
    """Seekable file of what a gzip stream holds."""

    def __init__(self, stream: GzipStream) -> None:
        super().__init__()
        self._stream, self._position = stream, 0

    def readable(self) -> bool:
        """Return True."""
        return True

    def seekable(self) -> bool:
        """Return True."""
        return True

    def tell(self) -> int:
        """Return the position."""
        return self._position

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Set the position; relative to the end is not supported."""
        if whence == io.SEEK_END:
            raise io.UnsupportedOperation("the end of a gzip stream is not known")
        self._position = offset + (self._position if whence == io.SEEK_CUR else 0)
        return self._position

    def read(self, size: int = -1) -> bytes:
        """Return the next ``size`` bytes, fewer at the end."""
        data = self._stream.read(self._position, self._position + size)
        self._position += len(data)
        return data


def list_tar(file: IO[bytes] | UnpackedFile, url: str) -> dict[str, ArchiveMember]:
    """Return the files of a tar archive by name; InputError if it is damaged or cut short.

    Hard links are listed with the data of their file, other links are left out.
    """
    members: dict[str, ArchiveMember] = {}
    try:
        with tarfile.open(fileobj=file, mode="r:") as archive:
            while (info := archive.next()) is not None:
                archive.members = []  # it would grow with the archive  # pyrefly: ignore[missing-attribute]
                if info.isreg():
                    members[info.name] = ArchiveMember(
                        info.offset_data, info.size, info.size, f"{info.mtime}"
                    )
                elif info.islnk() and info.linkname in members:
                    members[info.name] = members[info.linkname]
            file.seek(archive.offset)
            if file.read(_TAR_BLOCK) != bytes(_TAR_BLOCK):
                raise tarfile.ReadError("no end mark")
            while isinstance(file, UnpackedFile) and file.read(_CHUNK):
                pass  # up to the checksum at the end of the stream
    except (tarfile.TarError, EOFError, zlib.error, ValueError) as error:
        raise InputError(f"{url}: the archive is damaged or cut short ({error}); copy it again") from error
    return members


KINDS = {".zip": "zip", ".tar": "tar", ".tar.gz": "tar", ".tgz": "tar"}
"""End of an archive's name → kind of archive."""
_GZIP_MAGIC = b"\x1f\x8b"
_OPEN_STREAMS = 2
"""Compressed archives whose state is kept per process, each up to about 80 MB."""
_STREAMS: OrderedDict[str, GzipStream | None] = OrderedDict()
_LOCK = Lock()


def list_archive(kind: str, url: str) -> dict[str, ArchiveMember]:
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
            is_packed = read_bytes(url, 0, len(_GZIP_MAGIC)) == _GZIP_MAGIC
            _STREAMS[url] = GzipStream(partial(read_bytes, url), measure_size(url)) if is_packed else None
        _STREAMS.move_to_end(url)
        while len(_STREAMS) > _OPEN_STREAMS:
            _STREAMS.popitem(last=False)
        return _STREAMS[url]
