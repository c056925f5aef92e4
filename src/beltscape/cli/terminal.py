"""The reporter of the command line: progress and warnings on standard error."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


class Terminal:
    """Reporter that shows progress bars on a terminal, and one line per finished stage elsewhere."""

    def __init__(self) -> None:
        self.warnings: list[str] = []
        self._bars: Progress | None = None
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> Terminal:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

            self._bars = Progress(
                TextColumn("{task.description:<28}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
                console=Console(stderr=True),
            )  # fmt: skip
            self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bars is not None:
            self._bars.stop()

    def step(self, stage: str, done: int, total: int) -> None:
        """Update the progress of a stage."""
        if self._bars is None:
            if done == total:
                print(f"{stage}: {total} done", file=sys.stderr, flush=True)
            return
        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(stage, total=total)
        self._bars.update(self._tasks[stage], completed=done, total=total)

    def warn(self, message: str) -> None:
        """Print a warning in one line on standard error, each only once."""
        if message in self.warnings:
            return
        self.warnings.append(message)
        line = f"warning: {message}"
        if self._bars is None:
            print(line, file=sys.stderr, flush=True)
        else:
            self._bars.console.print(line, style="yellow", highlight=False, soft_wrap=True, markup=False)
