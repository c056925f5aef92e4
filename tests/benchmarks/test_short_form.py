"""The short form of the bench of faults: its rows on drawn images and computed depth maps, against exact truth."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest

from tests.benchmarks.drawn_plant import FRAMES, DrawnCapture, play_drawn
from tests.thorough import list_cases

ROOT = Path(__file__).resolve().parents[2]
SOUND_ROUNDS, ROUNDS = 1, 1.5
ROWS = {
    "sound": 0.0,
    "encoder frozen": 0.0,
    "encoder reversed": 0.0,
    "projector off": 0.0,
    "core frozen": 0.0,
    "belt risen 5 mm": 5.0,
}
"""Rows of cases.toml, with the height by which the belt has risen since its zero was learned, mm."""


@pytest.fixture(autouse=True)
def on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))


@pytest.mark.thorough
@pytest.mark.parametrize("row", list_cases(ROWS, ("encoder frozen",)))
def test_row_passes(row: str) -> None:
    (case,) = (case for case in import_module("faults.cases").read_cases() if case.name == row)
    onset = 0 if case.zero_faults else SOUND_ROUNDS * FRAMES
    count = round((SOUND_ROUNDS + ROUNDS) * FRAMES)
    played = import_module("faults.player").Played(case, onset, count)
    feed = import_module("faults.feed").Feed
    play_drawn(feed, played, rise_mm=ROWS[row])
    verdict = import_module("faults.verdict").assess(DrawnCapture(), played)
    assert verdict.passes, (verdict.noticed, verdict.published, verdict.error, verdict.failures)
