"""Place of a recording's files: a folder, a part of an archive, or a bucket."""

from __future__ import annotations

import re
from dataclasses import dataclass

from beltscape.core.errors import InputError
from beltscape.reprocessing.recordings.archives.reading import read_member, split_member
from beltscape.reprocessing.recordings.storage import (
    UnreachableError,
    join_address,
    named_faults,
    open_storage,
    read_bytes,
)

_ARCHIVE = re.compile(r"(zip|tar)://(.*?)::(.+)", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Place:
    """A folder, an archive or a bucket that is read through fsspec; cheap to send to another process.

    Its file system, and what an archive needs, are kept per process.
    """

    url: str
    """Absolute path, address, or fsspec's chained address of a folder in an archive: ``zip://folder::/data/day.zip``."""

    @property
    def archive(self) -> tuple[str, str, str] | None:
        """Kind of archive (``zip`` or ``tar``), folder in it, address of the archive; None for a folder or bucket."""
        match = _ARCHIVE.fullmatch(self.url)
        return None if match is None else (match[1], match[2], match[3])

    @property
    def address(self) -> str:
        """The place for messages: an archive is shown as a folder."""
        archive = self.archive
        return self.url if archive is None else join_address(archive[2], archive[1])

    def describe(self, path: str) -> str:
        """Return the address of a file for messages."""
        return join_address(self.address, path if self.archive is None else split_member(path)[0])

    def describe_folder(self, path: str) -> str:
        """Return the address of a folder or listed file for messages, by its path without a range."""
        return join_address(self.address, path)

    def read(self, path: str) -> bytes:
        """Return the bytes of a file; may be called from several threads at once.

        Raises
        ------
        InputError
            When this file is missing, damaged, locked or too large.
        UnreachableError
            When the place as a whole does not answer or is not there on this machine.
        """
        archive = self.archive
        try:
            if archive is not None:
                return read_member(archive[0], archive[2], path, self.describe(path))
            return read_bytes(join_address(self.url, path))
        except InputError as error:
            if isinstance(error.__cause__, OSError):
                self._require_presence()
            raise

    def _require_presence(self) -> None:
        """Raise UnreachableError where the whole place is missing: then its images are not lost, but elsewhere."""
        archive = self.archive
        url = self.url if archive is None else archive[2]
        with named_faults(url):
            file_system, path = open_storage(url)
            if not file_system.exists(path):
                raise UnreachableError(
                    f"{url}: is not there on this machine; let every worker see it under the same path"
                )
