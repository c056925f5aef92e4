"""The choice of workers: tasks run in this process, on processes of this machine, or on a Ray cluster."""

from __future__ import annotations

from dataclasses import dataclass

from beltscape.core.errors import SettingsError

MOST_WORKERS = 4096
"""More workers than one driver can feed: Ray hands out some thousand tasks a second."""


@dataclass(frozen=True, slots=True)
class WorkerOptions:
    """The workers on which tasks run."""

    workers: int | None = None
    """Largest number of tasks at a time, with a core each; None: as many as the cluster of ``address`` has cores."""
    address: str | None = None
    """A Ray cluster: "auto", "host:port" or "ray://host:port"; None: this machine."""

    def __post_init__(self) -> None:
        if self.workers is not None and not 1 <= self.workers <= MOST_WORKERS:
            raise SettingsError(f"--workers {self.workers}: must be between 1 and {MOST_WORKERS}")

    @property
    def is_here(self) -> bool:
        """Return whether the tasks run in this process, one after the other, each with all cores."""
        return self.address is None and self.workers is None


HERE = WorkerOptions()
"""In this process."""
