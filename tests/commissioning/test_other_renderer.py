"""A commissioning whose cameras are captures of another renderer, from the boards to the certificate.

What does not fit is refused with one line that names it and the fix.
"""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from beltscape.cli.main import main
from beltscape.commissioning import staged_cameras
from beltscape.commissioning.state import CommissionState
from beltscape.commissioning.steps import STEPS, get_status
from tests.stereo.rendered import RENDERED, needs_rendered

pytestmark = [needs_rendered, pytest.mark.thorough]  # five cameras of 1224 × 1024 px
SCENES = {"calibration": "calibration", "empty": "belt_empty", "moving": "belt_moving",
          "rocks_1": "belt_loaded", "rocks_2": "belt_loaded", "module_1": "module", "module_2": "module"}  # fmt: skip
"""Capture of the plant → that of the renderer."""
ENCODER = "frame,timestamp_s,belt_position_mm\n000,0,0\n"
MATERIAL_TEST = ("material", "certificate")


@pytest.fixture(scope="module")
def captures(tmp_path_factory) -> Path:
    """Captures as an engineer would lay them out; the images are linked."""
    folder = tmp_path_factory.mktemp("captures")
    for name, scene in SCENES.items():
        shutil.copytree(RENDERED / scene, folder / name, copy_function=lambda a, b: Path(b).symlink_to(a))
        if name not in ("calibration", "empty", "moving"):
            (folder / name / "encoder.csv").write_text(ENCODER)
    return folder


def call(plant: Path, capsys, *words: str) -> tuple[int, dict, str]:
    capsys.readouterr()
    code = main(["commission", str(plant), "--json", *words])
    out, err = capsys.readouterr()
    return code, json.loads(out), err


def set_all(plant: Path, capsys, *assignments: str) -> None:
    words = [word for one in assignments for word in ("--set", one)]
    assert call(plant, capsys, *words)[0] == 0


def true_m3(scene: str, from_mm: float, to_mm: float, axis_mm: float) -> float:
    """Return the true volume between two places along the belt, in the belt's frame, by the height field."""
    field = np.load(RENDERED / f"truth/{scene}_heightfield_world.npz")
    step, (rows, columns) = float(field["step"]), field["z"].shape
    x, y = (float(field[f"{key}0"]) + step * np.arange(n) for key, n in (("x", columns), ("y", rows)))
    belt = np.maximum(np.abs(x) - 150.0, 0.0) * math.tan(math.radians(25.0))
    areas = np.maximum(field["z"].astype(float) - belt, 0.0).sum(axis=1) * step
    edges = np.append(y - step / 2, y[-1] + step / 2) - axis_mm
    reached = np.concatenate([[0.0], np.cumsum(areas * step)])
    low, high = np.interp([from_mm, to_mm], edges, reached)
    return float(high - low) * 1e-9


def find_axis_mm() -> float:
    """Return where the core camera's axis meets the belt, mm along it."""
    camera = json.loads((RENDERED / "truth/rig.json").read_text())["cameras"]["cam0"]
    turn, place = np.array(camera["R"]), np.array(camera["t"])
    centre, axis = -turn.T @ place, turn[2]
    return float(centre[1] - centre[2] / axis[2] * axis[1])


def test_captures_of_another_renderer_come_to_a_certificate(captures, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(staged_cameras, "PERIOD_S", 0.0)
    plant = tmp_path / "plant"
    set_all(plant, capsys, "source=captures", f"captures={captures}", f"board.file={RENDERED / 'board.toml'}",
            "tolerance_mm=0.2", "load_mm=200", "operator=eva")  # fmt: skip
    found: dict[str, dict] = {}
    for step in STEPS[:-2]:
        code, document, err = call(plant, capsys, "--step", step.name)
        assert code == 0, (step.name, err)
        found[step.name] = document["result"]
    assert found["trigger"] == {"instants": 24, "incomplete": 0}
    assert found["calibrate"]["held_out_px"] < 0.1
    assert found["skew"] == {"delays": None}
    true_l = 1e-6 * json.loads((RENDERED / "truth/belt_moving.json").read_text())["total_volume_mm3"]
    live = found[
        "live"
    ]  # of images of half the width, to which the rig is scaled; the heap begins and ends in view
    assert (live["records"], live["missing_share"]) == (24, 0)
    assert abs(live["litres"] - true_l) < 3 * live["sigma_litres"]
    assert abs(live["litres"] / true_l - 1) < 0.02
    axis_mm = find_axis_mm()
    runs = ", ".join(
        f'{{capture = "{captures / name}", load = "{name[:-2]}", volume_m3 = 1.0}}'
        for name in list(SCENES)[3:]
    )
    set_all(plant, capsys, f"runs=[{runs}]", "reference.name=height field", "reference.sigma_percent=0.1")
    assert (
        call(plant, capsys, "--step", "material")[0] == 0
    )  # measures the flows, from which the strips are known
    truths = {}
    for name in list(SCENES)[3:]:
        strips = json.loads((plant / f"flow_{name}/flow.json").read_text())["strips"]
        truths[name] = true_m3(SCENES[name], strips[0]["start_mm"], strips[-1]["end_mm"], axis_mm)
    runs = ", ".join(
        f'{{capture = "{captures / name}", load = "{name[:-2]}", volume_m3 = {truth}}}'
        for name, truth in truths.items()
    )
    set_all(plant, capsys, f"runs=[{runs}]")
    for name in MATERIAL_TEST:
        code, document, err = call(plant, capsys, "--step", name)
        assert code == 0, (name, err)
        found[name] = document["result"]
    print(json.dumps(found, indent=1))
    (error,) = found["material"]["errors"]
    assert abs(error["value"]) < 3 * error["sigma"] + 1.0, "percent"
    state = CommissionState(plant)
    assert [get_status(state, step) for step in STEPS] == ["done"] * len(STEPS)


def test_what_does_not_fit_is_refused_by_name(captures, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(staged_cameras, "PERIOD_S", 0.0)
    plant, mine = tmp_path / "plant", tmp_path / "mine"
    mine.mkdir()

    def refuse(step: str, *said: str) -> None:
        code, document, _ = call(plant, capsys, "--step", step)
        line = document["error"]["message"]
        print(f"{step}: {line}")
        assert code == 2, step
        assert "\n" not in line
        for word in said:
            assert word in line, (step, line)

    set_all(plant, capsys, "source=captures")
    refuse("cameras", "captures:", "give the folder with calibration, empty and moving")
    set_all(plant, capsys, f"captures={mine}")
    refuse("cameras", str(mine / "calibration"))
    (mine / "calibration").symlink_to(captures / "calibration")
    set_all(plant, capsys, "core=cam7")
    refuse("cameras", "core = 'cam7'", "cam0, cam1, cam2, cam3, cam4")
    set_all(plant, capsys, "core=cam0")
    for step in ("cameras", "board"):
        assert call(plant, capsys, "--step", step)[0] == 0
    refuse("calibrate", "board")  # of 12 × 9 squares, where the pictures show one of 11 × 8
    set_all(plant, capsys, f"board.file={RENDERED / 'board.toml'}", "tolerance_mm=0.2")
    for step in ("board", "calibrate", "rig"):
        assert call(plant, capsys, "--step", step)[0] == 0, step
    refuse("empty", str(mine / "empty"))
    (mine / "empty").symlink_to(RENDERED / "belt_empty_nospeckle")
    refuse("empty", "empty")
    (mine / "empty").unlink()
    (mine / "empty").symlink_to(captures / "empty")
    assert call(plant, capsys, "--step", "empty")[0] == 0
    refuse("project", str(mine / "moving"))
    (mine / "moving").symlink_to(captures / "moving")
    assert call(plant, capsys, "--step", "project")[0] == 0
    assert '"capture"' in (plant / "project.toml").read_text(), "the encoder that was not there before"
    (mine / "moving").unlink()
    refuse("live", str(mine / "moving"))
