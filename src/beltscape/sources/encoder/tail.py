"""Encoder readings at the end of a file that grows."""

from __future__ import annotations

from pathlib import Path
from threading import Event, Thread
from time import monotonic_ns

from beltscape.core.errors import InputError
from beltscape.sources.encoder.growing import GrowingFile
from beltscape.sources.encoder.origin import Origin
from beltscape.sources.encoder.settings import EncoderSettings
from beltscape.sources.encoder.stream import Stream


class TailEncoder(Stream):
    """Looks at the file every few milliseconds, in a thread of its own; survives its being rotated or away."""

    def __init__(
        self,
        path: Path,
        settings: EncoderSettings,
        origin: Origin | None = None,
        resume_mm: float | None = None,
    ) -> None:
        """A file that is not there yet is waited for; InputError where one may not read it."""
        super().__init__(settings, origin, resume_mm)
        self._path = path
        try:
            self._file = GrowingFile(path)
        except OSError as error:
            raise InputError(
                f"{path}: cannot be read ({error.strerror or error}); check its rights"
            ) from error
        self._stop = Event()
        self._thread = Thread(target=self._run, name="encoder", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(self._settings.poll_s):
            now_ns = monotonic_ns()
            try:
                for line in self._file.lines():
                    self.take(line, now_ns)
            except OSError as error:
                reason = error.strerror or str(error)
                self.note("file", f"{self._path}: cannot be read ({reason}); check its rights", now_ns)
        self._file.close()

    def close(self) -> None:
        """Stop looking."""
        super().close()
        self._stop.set()
        self._thread.join()
