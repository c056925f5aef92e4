"""Reporters of progress and warnings during long computations."""

from __future__ import annotations

from typing import Protocol


class Reporter(Protocol):
    """Receiver of progress and warnings, such as a terminal; raising an exception in it cancels the computation."""

    def step(self, stage: str, done: int, total: int) -> None:
        """Report that ``done`` of ``total`` parts of ``stage`` are finished."""

    def warn(self, message: str) -> None:
        """Report a problem that did not stop the computation, in one line."""


class Silent:
    """Reporter that collects the warnings and shows nothing."""

    def __init__(self) -> None:
        self.warnings: list[str] = []

    def step(self, stage: str, done: int, total: int) -> None:
        """Do nothing."""

    def warn(self, message: str) -> None:
        """Collect the warning."""
        self.warnings.append(message)


class RecordingReporter:
    """Reporter that forwards everything and collects the warnings of one computation."""

    def __init__(self, to: Reporter) -> None:
        self._to = to
        self.warnings: list[str] = []

    def step(self, stage: str, done: int, total: int) -> None:
        """Forward the progress."""
        self._to.step(stage, done, total)

    def warn(self, message: str) -> None:
        """Collect the warning and forward it, each only once."""
        if message not in self.warnings:
            self.warnings.append(message)
            self._to.warn(message)
