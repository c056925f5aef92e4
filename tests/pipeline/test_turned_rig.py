"""Three cameras in an L, turned against a belt whose floor is in view on both sides: from images to volume."""

from __future__ import annotations

import json

import pytest

from beltscape.files.belt_json import read_belt

SCENE = """kind = "{kind}"
[rig]
auxiliaries = 2
around_deg = 180
yaw_deg = 25
scale = 0.25
seed = 11
[belt]
width_mm = 520
flat_mm = 180
floor_mm = 320
length_mm = 3000
floor_reflectance = 0.35
[projector]
covers_mm = 1100
[heap]
rocks = 150
[heap.sizes]
median_mm = 30
largest_mm = 50
[heap.fines]
crown_mm = 40
along_mm = [-400, 400]
[render]
oversample = 1
passes = 1
ambient_samples = 1
"""


@pytest.mark.thorough
def test_the_floor_beside_the_belt_counts_for_nothing(run, tmp_path):
    for name in ("empty", "moving"):
        (tmp_path / f"{name}.toml").write_text(SCENE.format(kind=f"belt_{name}"))
        assert run("simulate", tmp_path / f"{name}.toml", "--out", tmp_path / name)[0] == 0
    rig = tmp_path / "empty/truth/rig.json"
    empty, depth, belt = tmp_path / "empty", tmp_path / "depth_empty", tmp_path / "belt.json"
    assert run("reconstruct", empty, "--rig", rig, "--preset", "fast", "--out", depth)[0] == 0
    assert run("measure", "belt", depth, "--out", belt)[0] == 0
    left, right = read_belt(belt)[0].across_mm
    assert right - left == pytest.approx(180 + 340 * 0.9063, abs=8)
    code, _, _ = run(
        "measure", "flow", tmp_path / "moving", "--rig", rig, "--empty", belt,
        "--encoder", tmp_path / "moving/encoder.csv", "--preset", "fast", "--out", tmp_path / "flow",
    )  # fmt: skip
    assert code == 0
    totals = json.loads((tmp_path / "flow/flow.json").read_text())["totals"]
    truth_mm3 = json.loads((tmp_path / "moving/truth/belt_moving.json").read_text())["heap_volume_mm3"]
    error = totals["volume_mm3"] - truth_mm3
    assert abs(error) < 2.5 * totals["sigma_mm3"]
    assert abs(error) < 0.02 * truth_mm3
    assert totals["sigma_mm3"] < 0.03 * truth_mm3
