"""Faster collection of tests by several workers, as a plugin of pytest."""

from __future__ import annotations

import gc
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import pytest

_TESTS = Path(__file__).parent


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    """Import the test modules before they are collected, each worker from another one on.

    In a fresh clone pytest rewrites the assertions of every module, which takes as long as the rest of collecting.
    The workers read what another one has written instead of doing all of it themselves. What an import raises, it
    raises again when the module is collected.
    """
    gc.disable()  # nearly all of these objects stay until the end
    worker = getattr(session.config, "workerinput", None)
    if worker is not None:
        paths = sorted(path for word in session.config.args for path in _list_modules(session, word))
        first = len(paths) * int(worker["workerid"].removeprefix("gw")) // worker["workercount"]
        for path in paths[first:] + paths[:first]:
            with suppress(Exception, pytest.skip.Exception):
                import_module(".".join(path.relative_to(_TESTS.parent).with_suffix("").parts))


def pytest_collection_finish() -> None:
    """Leave what has been collected out of all later searches for garbage."""
    gc.freeze()
    gc.enable()


def _list_modules(session: pytest.Session, word: str) -> list[Path]:
    """Return the test modules below a folder that is named in the call; empty for a file or a single test."""
    folder, config = session.config.invocation_params.dir / word, session.config
    return [
        path
        for path in folder.rglob("test_*.py")
        if _TESTS in path.parents
        and not config.hook.pytest_ignore_collect(collection_path=path, config=config)
    ]
