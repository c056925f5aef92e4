"""Work on captures that does not depend on each other, on one or several workers of this machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from beltscape.learned.registry import use_networks
from beltscape.workers.options import HERE, WorkerOptions
from beltscape.workers.tasks import collect_values


@dataclass(frozen=True)
class Drawing:
    """Where captures are rendered and samples drawn; these are the same with any number of workers."""

    workers: WorkerOptions = HERE
    networks: Path | None = None
    """Folder of the networks that samples are drawn with; None: those that ship."""

    def run(
        self, function: Callable[..., Any], tasks: list[tuple[Any, ...]], on_end: Callable[[int], None]
    ) -> None:
        """Call a function with the arguments of each task; ``on_end`` receives the number of ended tasks."""
        collect_values(_call, (function, self.networks), tasks, self.workers, on_end)


def _call(shared: tuple[Callable[..., Any], Path | None], arguments: tuple[Any, ...]) -> None:
    function, networks = shared
    if networks is not None:
        use_networks(networks)
    function(*arguments)
