"""What is made once in a run of the tests, whatever the number of its workers."""

from __future__ import annotations

import fcntl
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

import pytest


@contextmanager
def hold_lock(path: Path) -> Generator[None]:
    """Keep all other workers that ask for the same lock waiting until the context ends."""
    with path.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def make_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], None]) -> Path:
    """Return a folder that the first worker to ask for it fills by ``make``; the others wait.

    One name is made by one function: what another one would have made is not taken for it.
    """
    shared = factory.getbasetemp()
    shared = shared.parent if shared.name.startswith("popen") else shared
    folder, done = shared / name, shared / f"{name}.done"
    with hold_lock(shared / f"{name}.lock"):
        if not done.is_file():
            folder.mkdir()
            make(folder)
            done.write_text(f"{make.__module__} {make.__qualname__}")
        elif done.read_text() != (asked := f"{make.__module__} {make.__qualname__}"):
            raise ValueError(f"{name} was made by {done.read_text()}, not by {asked}")
    return folder
