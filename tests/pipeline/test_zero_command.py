"""``measure zero`` on rendered images: the belt rose by a known amount since it was learned."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.geometry.pose import Pose
from beltscape.files.belt_json import read_belt, write_belt

RISE_MM = 1.3


@pytest.fixture
def learned(run, small_frames: Path, tmp_path: Path) -> Path:
    """Return the belt.json that was learned before the rendered belt rose."""
    now, before = tmp_path / "now.json", tmp_path / "before.json"
    assert run("measure", "belt", small_frames / "belt_empty", "--out", now)[0] == 0
    belt, camera = read_belt(now)
    motion = Pose(np.eye(3), np.array([0.0, 0.0, RISE_MM]))
    write_belt(before, replace(belt, belt_from_core=motion @ belt.belt_from_core), camera)
    return before


def test_the_rise_is_measured_within_its_sigma(
    run, small_frames: Path, learned: Path, tmp_path: Path
) -> None:
    out, empty = tmp_path / "zero.json", small_frames / "belt_empty"
    code, text, _ = run("measure", "zero", empty, "--empty", learned, "--out", out, "--json")
    found = json.loads(text)
    assert code == 0
    assert abs(found["offset_mm"] - RISE_MM) < 3 * found["offset_sigma_mm"] + 0.02
    assert found["offset_sigma_mm"] < 0.3
    again = json.loads(
        run("measure", "zero", empty, "--empty", out, "--out", tmp_path / "b.json", "--json")[1]
    )
    assert abs(again["offset_mm"]) < 3 * again["offset_sigma_mm"]


def test_a_rise_beyond_the_limit_and_a_loaded_belt_are_refused(
    run, small_frames: Path, learned: Path, tmp_path: Path
) -> None:
    out = tmp_path / "zero.json"
    for scene, limit in (("belt_empty", 1), ("belt_loaded", 2)):
        code, _, errors = run(
            "measure", "zero", small_frames / scene, "--empty", learned, "--set-limit", limit, "--out", out
        )
        assert code == 2 and errors[-1].startswith("beltscape: ")
        assert not out.exists()
