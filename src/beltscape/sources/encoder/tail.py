"""Encoder readings that another program appends to a text file."""

from __future__ import annotations

import os
from pathlib import Path
from threading import Event
from time import monotonic_ns
from typing import BinaryIO

from beltscape.core.errors import InputError
from beltscape.core.supervision import make_supervised_thread
from beltscape.sources.encoder.readings import EncoderOffset, ReadingStream
from beltscape.sources.encoder.settings import EncoderSettings

_BACK = 4096
"""Bytes at the end of the file in which the last complete line ends."""
_CHUNK = 1 << 20
"""Bytes read at once."""
_LONGEST_LINE = 1 << 16
"""Bytes of an incomplete line that are kept; a reading has at most 256."""


class FileTail:
    """Reads appended lines once they are complete; a rotated file is read to its end before its successor.

    Lines that the file holds at first are skipped; a file that appears later, or replaces another, is read from its
    beginning.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: BinaryIO | None = None
        self._rest = b""
        if path.is_file():
            self._open()
            self._skip_present()

    def read_lines(self) -> list[str]:
        """Return the lines completed since the previous call; OSError if the file cannot be read."""
        if self._file is None and not self._open():
            return []
        lines = self._read()
        if self._is_replaced():
            lines += self._read()  # lines written between the last read and the renaming
            self._open()
            lines += self._read()
        return lines

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _open(self) -> bool:
        self.close()
        self._rest = b""
        try:
            self._file = self._path.open("rb")
        except FileNotFoundError:
            return False
        return True

    def _skip_present(self) -> None:
        """Move to the beginning of the line that is being written."""
        if self._file is None:
            return
        size = self._file.seek(0, os.SEEK_END)
        start = self._file.seek(max(0, size - _BACK))
        last = self._file.read(_BACK).rfind(b"\n")
        self._file.seek(start + last + 1)

    def _read(self) -> list[str]:
        file = self._file
        if file is None:
            return []
        if os.fstat(file.fileno()).st_size < file.tell():  # emptied in place
            file.seek(0)
            self._rest = b""
        lines: list[str] = []
        while chunk := file.read(_CHUNK):
            *whole, self._rest = (self._rest + chunk).split(b"\n")
            lines += [line.decode("utf-8", "replace").strip() for line in whole]
            if len(self._rest) > _LONGEST_LINE:
                self._rest = self._rest[:_LONGEST_LINE]  # longer than any reading: refused once it ends
        return lines

    def _is_replaced(self) -> bool:
        """Return whether the path now names another file."""
        if self._file is None:
            return False
        try:
            there = self._path.stat()
        except FileNotFoundError:
            return False
        return not os.path.samestat(there, os.fstat(self._file.fileno()))


class TailEncoder(ReadingStream):
    """Polls the file in a thread of its own; the file may be rotated, removed and created again."""

    def __init__(
        self,
        path: Path,
        settings: EncoderSettings,
        offset: EncoderOffset | None = None,
        resume_mm: float | None = None,
    ) -> None:
        """Start polling; the file may appear later. InputError if it may not be read."""
        super().__init__(settings, offset, resume_mm)
        self._path = path
        try:
            self._file = FileTail(path)
        except OSError as error:
            raise InputError(
                f"{path}: cannot be read ({error.strerror or error}); check its rights"
            ) from error
        self._stop = Event()
        self._thread = make_supervised_thread("encoder", self._run, self.add_failure, self._stop.wait)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(self._settings.poll_s):
            now_ns = monotonic_ns()
            try:
                for line in self._file.read_lines():
                    self.add_line(line, now_ns)
            except OSError as error:
                reason = error.strerror or str(error)
                self.add_notice("file", f"{self._path}: cannot be read ({reason}); check its rights", now_ns)
        self._file.close()

    def close(self) -> None:
        """Stop polling."""
        super().close()
        self._stop.set()
        self._thread.join()
