"""Supervised threads: failed work starts again, and every failure is reported."""

from __future__ import annotations

import ast
import logging
import threading
from pathlib import Path

import pytest

import beltscape
from beltscape.core import supervision
from beltscape.core.supervision import log_uncaught_errors, make_supervised_thread

UNSUPERVISED = {
    ("supervision.py", "name"),
    ("camera.py", "f'camera {name}'"),  # its loop opens the camera again after any error
    ("camera.py", "f'close {self._name}'"),  # ends with its one call
    ("runner.py", "'output of a step'"),  # ends with the step's command
    ("system_calls.py", "'beginner'"),  # ends its own process
    ("session.py", "f'step {name}'"),  # keeps its own failure and shows it
}


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    monkeypatch.setattr(supervision, "RESTART_S", 0.01)


def test_failed_work_starts_again_until_it_returns(caplog):
    stop, calls, failures = threading.Event(), [], []

    def work() -> None:
        calls.append(1)
        if len(calls) < 4:
            raise [ValueError("a\nb"), PermissionError(13, "Permission denied"), MemoryError()][
                len(calls) - 1
            ]

    with caplog.at_level(logging.ERROR, "beltscape"):
        thread = make_supervised_thread("one", work, failures.append, stop.wait)
        thread.start()
        thread.join(5)
    assert len(calls) == 4
    assert failures[0] == "ValueError: a b"
    assert failures[1].startswith("PermissionError: ") and failures[2].startswith("MemoryError")
    assert [r.message.partition(":")[0] for r in caplog.records] == ["one"] * 3


def test_stopping_ends_the_restarts():
    stop = threading.Event()

    def work() -> None:
        stop.set()
        raise ValueError

    thread = make_supervised_thread("one", work, lambda _: None, stop.wait)
    thread.start()
    thread.join(5)
    assert not thread.is_alive()


def test_an_uncaught_error_of_a_thread_is_logged(caplog, monkeypatch):
    monkeypatch.setattr(threading, "excepthook", threading.excepthook)
    log_uncaught_errors()

    def work() -> None:
        raise KeyError("x")

    with caplog.at_level(logging.ERROR, "beltscape"):
        thread = threading.Thread(target=work, name="library")
        thread.start()
        thread.join()
    assert "library ended: KeyError" in caplog.text


def test_no_thread_of_the_program_is_unsupervised():
    """Every thread is made by ``make_supervised_thread``, or is listed above with the reason."""
    found = set()
    for path in Path(beltscape.__file__).parent.rglob("*.py"):
        text = path.read_text("utf-8")
        for node in ast.walk(ast.parse(text)) if "Thread(" in text else ():
            if isinstance(node, ast.Call) and ast.unparse(node.func) in ("threading.Thread", "Thread"):
                name = next((ast.unparse(word.value) for word in node.keywords if word.arg == "name"), "")
                found.add((path.name, name))
    assert found == UNSUPERVISED
