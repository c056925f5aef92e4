"""Reporters of progress and warnings."""

from __future__ import annotations

from beltscape.core.progress import Silent


def test_silent_reporter_collects_the_warnings_in_order():
    reporter = Silent()
    reporter.step("working", 1, 2)
    reporter.warn("first")
    reporter.warn("second")
    assert reporter.warnings == ["first", "second"]
