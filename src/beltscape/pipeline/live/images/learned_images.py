"""References that a run learned from its images, in the monitors and on the disk; an engineer may renew them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from beltscape.files.folders.atomic import output_error


class LearningMonitor(Protocol):
    """A monitor that learns what sound images show."""

    def learn_anew(self) -> None:
        """Forget what was learned, before the next frame; any thread may call it."""
        ...


@dataclass(frozen=True, slots=True)
class LearnedImages:
    """The monitors that learn from images, and the files in which they keep it."""

    monitors: Sequence[LearningMonitor] = ()
    paths: Sequence[Path] = ()

    def learn_anew(self) -> bool:
        """Remove the files and let the monitors learn from the next sound frames; return whether anything learns.

        Raises
        ------
        OutputError
            When a file cannot be removed; then nothing is forgotten.
        """
        for path in self.paths:
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise output_error(path, error) from error
        for monitor in self.monitors:
            monitor.learn_anew()
        return bool(self.monitors)
