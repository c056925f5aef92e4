"""The ablation: each row changes the matcher that runs and nothing after it; figures are scored and printed."""

from __future__ import annotations

import sys
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from beltscape.stereo.settings import MultiviewSettings
from tests.synthetic.demo import crop_demo_rig, read_cropped_frame, read_cropped_truth

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
SCENE = "belt_loaded"


@pytest.fixture
def ablation(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    before = set(sys.modules)
    yield import_module("ablation")
    for name in ("ablation", "matching.scenes", "matching", "captures"):
        if name not in before:
            sys.modules.pop(name, None)


@pytest.fixture
def scene(ablation):
    """The demo's loaded belt, one pair of cameras."""
    scenes, captures = import_module("matching.scenes"), import_module("captures")

    rig, frame = crop_demo_rig(), read_cropped_frame(SCENE, ("cam0", "cam1", "cam3"))
    true_mm = read_cropped_truth(SCENE).astype(np.float64)
    return scenes.AblationScene(
        captures.Scene("demo", rig, frame, true_mm, np.isfinite(true_mm), np.zeros(true_mm.shape, bool)),
        None,
        None,
    )


def test_rows_name_what_is_there_and_leave_nothing_changed(ablation):
    from beltscape.stereo.multiview import estimate

    def snapshot() -> list[object]:
        return [
            estimate.gather_neighbour_addresses, estimate.mask_uncertain, estimate.mask_accepted,
            estimate.refine_uncertain_pixels, estimate.inflate_sigma,
        ]  # fmt: skip

    before = snapshot()
    for row in ablation.ROWS:
        settings = MultiviewSettings.preset(row.preset)
        for name, value in (row.changes or {}).items():
            assert getattr(settings, name) != value  # switched off, not left as it was
        with row.patched():
            pass
    assert snapshot() == before
    assert len({row.name for row in ablation.ROWS}) == len(ablation.ROWS)


def test_a_row_changes_what_is_measured(ablation, scene, monkeypatch):
    monkeypatch.setattr(ablation, "_RUNS", 1)
    entered: list[str] = []

    @contextmanager
    def note() -> Generator[None]:
        entered.append("in")
        yield
        entered.append("out")

    rows = (ablation.Row("fast", "fast"), ablation.Row("strict", "fast", {"least_confidence": 0.9}, note))
    figures, strict = (ablation.measure(row, scene, (560.0, 760.0)) for row in rows)
    assert entered == ["in", "out"]
    assert 0.5 < strict.within_1mm < figures.within_1mm
    assert strict.gross < figures.gross < 0.1
    assert np.isnan(figures.volume_error)


def test_a_table_row_has_means_extremes_and_blanks(ablation):
    first = ablation.Figures(0.9, 0.8, 0.01, 0.2, 0.9, 1.1, -0.02, 1.0)
    second = replace(first, within_1mm=0.7, sigma_high=1.4, volume_error=0.04, cpu_s=3.0)
    assert ablation.format_row("both", [first, second]) == (
        "| both | 80.00% | 80.00% | 1.00% | 20.0% | 0.90–1.40 | 3.00% | 2.00 |"
    )
    alone = ablation.format_row("one", [replace(first, volume_error=np.nan)])
    assert alone == "| one | 90.00% | 80.00% | 1.00% | 20.0% | 0.90–1.10 |  | 1.00 |"
    assert "-2.00%" in ablation.format_row("one", [first])
