"""The quick form on rendered captures of a moving heap: its error against the exact truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from beltscape.cli.main import main

SCENE = """kind = "{kind}"
frames = {frames}
[rig]
auxiliaries = 2
scale = 0.25
[render]
oversample = 1
passes = 1
ambient_samples = 1
"""
MOVING = (
    "[motion]\nspeed_mm_s = 500\nframes_per_s = 3\nstart_mm = {start}\ngap_mm = 900\n[heap]\nrocks = 40\n"
)
PASSES = 3


def call(*words: object) -> None:
    assert main([str(word) for word in words]) == 0, words


def make_plant(folder: Path) -> Path:
    """Render empty belt and passes, measure them, and return the project of the plant."""
    (folder / "empty.toml").write_text(SCENE.format(kind="belt_empty", frames=2))
    call("simulate", folder / "empty.toml", "--out", folder / "empty")
    rig, belt = folder / "empty/truth/rig.json", folder / "belt.json"
    call("reconstruct", folder / "empty", "--rig", rig, "--preset", "fast", "--out", folder / "depth_empty")
    call("measure", "belt", folder / "depth_empty", "--out", belt)
    for number in range(PASSES):
        scene = SCENE.format(kind="belt_moving", frames=12) + MOVING.format(start=-797 - 37 * number)
        (folder / "moving.toml").write_text(scene)
        capture = folder / f"capture_{number}"
        call("simulate", folder / "moving.toml", "--out", capture)
        words = ("--encoder", capture / "encoder.csv", "--preset", "fast", "--out", folder / f"flow_{number}")
        call("measure", "flow", capture, "--rig", rig, "--empty", belt, *words)
    project = folder / "project.toml"
    project.write_text('rig = "empty/truth/rig.json"\nempty = "belt.json"\n[capture]\nfolder = "capture_0"\n')
    return project


@pytest.mark.slow
@pytest.mark.thorough
def test_the_error_of_the_volume_is_that_against_the_truth(tmp_path, capsys) -> None:
    pytest.importorskip("mitsuba")
    project = make_plant(tmp_path)
    truth = np.load(tmp_path / "capture_0/truth/belt_moving_load.npz")
    true_mm3 = float(np.trapezoid(truth["area_mm2"], truth["y_mm"]))
    edge, flows = true_mm3 ** (1 / 3), [tmp_path / f"flow_{number}" for number in range(PASSES)]
    capsys.readouterr()
    call("certify", "object", *flows, "--box", edge, edge, edge, "--sigma", 0.02, "--project", project, "--issue",
         "--out", tmp_path / "out", "--json")  # fmt: skip
    document = json.loads(capsys.readouterr().out)
    (error,) = document["errors"]
    volumes = [json.loads((flow / "flow.json").read_text())["totals"]["volume_mm3"] for flow in flows]
    by_hand = np.exp(np.log(np.array(volumes) / true_mm3).mean()) - 1
    assert error["value"] == pytest.approx(100 * by_hand, abs=1e-6)
    assert abs(error["value"]) < 0.5  # a rendered heap of 29 l; the meter states σ of 0.3 %
    assert set(document["applies"]) == {"rig", "empty", "networks", "program"}
    page = Path(document["certificate"]["page"]).read_text()
    assert page.count("data:image/webp;base64,") >= 1
