"""A moving belt of another renderer in the form of the bench's own captures."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.progress import Silent
from beltscape.files.belt_json import read_belt
from tests.measure.flow.moving_belt import CAMERA, depth_map

ROOT = Path(__file__).resolve().parents[2]
RENDERED = ROOT.parent / "shared" / "data" / "rendered"


@pytest.fixture
def imported_round(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return import_module("faults.imported_round")


@pytest.fixture
def capture(imported_round, monkeypatch, tmp_path):
    if not RENDERED.is_dir():
        pytest.skip("optional data: ../shared/data/rendered is not there")
    monkeypatch.setattr(imported_round, "_reconstruct_empty_belt", lambda *_: None)
    return imported_round.import_round(RENDERED, tmp_path, Silent())


def test_positions_go_on_over_rounds_and_the_load_is_that_of_the_truth(capture):
    steps = np.diff([capture.position_mm(frame) for frame in range(3 * capture.frames)])
    assert (np.abs(steps - 200) < 2.5).all()
    y_mm, area_mm2 = capture.area
    assert area_mm2.sum() * (y_mm[1] - y_mm[0]) == pytest.approx(1.12007e8, rel=1e-4)
    images = capture.images(capture.frames + 3).images
    assert {image.shape[:2] for image in images.values()} == {(512, 612)}
    assert (images["cam1"] == capture.images(3).images["cam1"]).all()


def test_a_zero_that_was_learned_wrong_is_the_empty_belt_displaced(imported_round, monkeypatch, tmp_path):
    belt = import_module("beltscape.measure.belt.empty_belt").find_belt(depth_map(None, 0.0, seed=9), CAMERA)
    monkeypatch.setattr(imported_round, "read_empty_belt", lambda *_: (belt, CAMERA))
    sizes = import_module("faults.capture").Sizes("", 1, 1.0, 1)
    plant = imported_round.ImportedRound(tmp_path, sizes, seed=0)
    lowered, _ = read_belt(plant.learn_zero("lowered", {"moved_belt": [{"rise_mm": -5.0}]}, Silent()))
    points = np.array([[0.0, 0.0, 600.0], [50.0, 20.0, 610.0]])
    offset = lowered.belt_from_core.apply(points) - belt.belt_from_core.apply(points)
    np.testing.assert_allclose(offset, [[0, 0, 5.0]] * 2, atol=1e-9)


def test_rows_that_need_another_plant_are_left_out(imported_round):
    cases = {case.name: case for case in import_module("faults.cases").read_cases()}
    assert imported_round.is_playable(cases["sound"])
    assert imported_round.is_playable(cases["belt risen 5 mm"])
    assert imported_round.is_playable(
        cases["plate 160 mm over the belt for 12 frames"]
    )  # drawn into its images
    assert not imported_round.is_playable(cases["splice 3 mm"])
    assert not imported_round.is_playable(cases["belt runs off by 60 mm"])
