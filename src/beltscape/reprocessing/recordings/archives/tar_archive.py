"""Tar archives, plain or gzip-compressed: list of the members with the ranges of their data."""

from __future__ import annotations

import io
import tarfile
import zlib
from typing import IO

from beltscape.core.errors import InputError
from beltscape.reprocessing.recordings.archives.gzip_stream import GzipStream
from beltscape.reprocessing.recordings.archives.member import Member

_BLOCK = 512
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


def list_tar(file: IO[bytes] | UnpackedFile, url: str) -> dict[str, Member]:
    """Return the files of a tar archive by name; InputError if it is damaged or cut short.

    Hard links are listed with the data of their file, other links are left out.
    """
    members: dict[str, Member] = {}
    try:
        with tarfile.open(fileobj=file, mode="r:") as archive:  # pyright: ignore[reportArgumentType]
            while (info := archive.next()) is not None:
                archive.members = []  # pyright: ignore[reportAttributeAccessIssue]  # it would grow with the archive
                if info.isreg():
                    members[info.name] = Member(info.offset_data, info.size, info.size, f"{info.mtime}")
                elif info.islnk() and info.linkname in members:
                    members[info.name] = members[info.linkname]
            file.seek(archive.offset)
            if file.read(_BLOCK) != bytes(_BLOCK):
                raise tarfile.ReadError("no end mark")
            while isinstance(file, UnpackedFile) and file.read(_CHUNK):
                pass  # up to the checksum at the end of the stream
    except (tarfile.TarError, EOFError, zlib.error, ValueError) as error:
        raise InputError(f"{url}: the archive is damaged or cut short ({error}); copy it again") from error
    return members
