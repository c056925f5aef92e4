"""Encoder readings that another program appends to a file."""

from __future__ import annotations

from pathlib import Path
from threading import Event
from time import monotonic_ns

from beltscape.core.errors import InputError
from beltscape.core.runtime.supervision import make_supervised_thread
from beltscape.sources.encoder.file_tail import FileTail
from beltscape.sources.encoder.offset import EncoderOffset
from beltscape.sources.encoder.readings.stream import ReadingStream
from beltscape.sources.encoder.settings import EncoderSettings


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
