"""The picture of a re-processing over time."""

from __future__ import annotations

from beltscape.reprocessing.manifest import WorkSpan
from beltscape.reprocessing.report import _cut_pauses, make_timeline


def test_a_pause_between_two_runs_is_cut_out() -> None:
    spans = [
        WorkSpan("a", 100.0, 30.0),
        WorkSpan("b", 101.0, 50.0),
        WorkSpan("a", 1151.0, 10.0),
        WorkSpan("b", 1165.0, 5.0),
    ]
    assert _cut_pauses(spans) == [0.0, 1.0, 51.0, 65.0]
    assert make_timeline(spans).caption == "4 pieces on 2 workers (processes)."
    assert make_timeline([]).caption == "0 pieces on 0 workers (processes)."
