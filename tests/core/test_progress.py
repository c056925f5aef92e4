from __future__ import annotations

from beltscape.core.progress import Silent


def test_a_silent_reporter_keeps_the_warnings_in_order():
    reporter = Silent()
    reporter.step("working", 1, 2)
    reporter.warn("first")
    reporter.warn("second")
    assert reporter.warnings == ["first", "second"]
