"""How long work tells where it stands, and what it noticed on the way."""

from __future__ import annotations

from typing import Protocol


class Reporter(Protocol):
    """Told by long work; a terminal, a dashboard and a test each implement it. Raising from it cancels."""

    def step(self, stage: str, done: int, total: int) -> None:
        """``done`` of ``total`` parts of ``stage`` are finished."""

    def warn(self, message: str) -> None:
        """Say something worth knowing that did not stop the work, in one line."""


class Silent:
    """Reporter that keeps the warnings and shows nothing."""

    def __init__(self) -> None:
        self.warnings: list[str] = []

    def step(self, stage: str, done: int, total: int) -> None:
        """Nothing to show."""

    def warn(self, message: str) -> None:
        """Keep it."""
        self.warnings.append(message)


class RecordingReporter:
    """Reporter that passes everything on and keeps the warnings of one piece of work."""

    def __init__(self, to: Reporter) -> None:
        self._to = to
        self.warnings: list[str] = []

    def step(self, stage: str, done: int, total: int) -> None:
        """Pass it on."""
        self._to.step(stage, done, total)

    def warn(self, message: str) -> None:
        """Keep it once and pass it on."""
        if message not in self.warnings:
            self.warnings.append(message)
            self._to.warn(message)
