"""Fixture: a clock that tests set."""

from __future__ import annotations

import time

import pytest

from beltscape.sinks import recorder as recorder_module


@pytest.fixture
def clock(monkeypatch):
    """A monotonic clock that only moves when it is set."""

    class Clock:
        now = 1000.0

        def monotonic(self) -> float:
            return self.now

        def __getattr__(self, name: str):
            return getattr(time, name)

    one = Clock()
    monkeypatch.setattr(recorder_module, "time", one)
    return one
