"""The measuring volume of a calibration: read from a plan, a belt or a project, and drawn where boards lack."""

from __future__ import annotations

import json

import pytest

from beltscape.calibration.assessment.coverage import UncoveredVolumeError
from beltscape.core.errors import InputError
from beltscape.files.belt_json import write_belt
from beltscape.pipeline.calibrating import calibration
from beltscape.pipeline.calibrating.measuring_volume import read_measuring_volume
from tests.files.test_belt_json import CAMERA, belt

BOARD = 'kind = "charuco"\nsquares = [8, 6]\nsquare_mm = 40\nmarker_mm = 29\ndictionary = "DICT_4X4_50"\n'
PLAN = "[belt]\nwidth_mm = 600\nspan_mm = 580\nflat_mm = 200\n[rig]\nheight_mm = 900\n"


def test_a_plan_gives_the_belt_below_its_core_camera(tmp_path):
    (tmp_path / "plan.toml").write_text(PLAN)
    volume = read_measuring_volume(tmp_path / "plan.toml")
    x, _, z = volume.points_mm.T
    assert (x.min(), x.max()) == pytest.approx((-290.0, 290.0))
    assert z.max() == pytest.approx(900.0)
    assert volume.is_given
    assert volume.name == "the belt of plan.toml"


def test_a_project_gives_its_empty_belt_and_its_load(tmp_path):
    learned = belt(full=True)
    write_belt(tmp_path / "belt.json", learned, CAMERA)
    (tmp_path / "project.toml").write_text('name = "Belt 3"\n[matching]\nload_mm = 250\n')
    high = read_measuring_volume(tmp_path / "project.toml")
    on_belt = learned.belt_from_core.apply(high.points_mm)
    assert (on_belt[:, 0].min(), on_belt[:, 0].max()) == pytest.approx(learned.across_mm)
    floor = learned.height_at_mm(on_belt[:, 0], on_belt[:, 1])
    assert (on_belt[:, 2] - floor).max() == pytest.approx(250.0)
    assert read_measuring_volume(tmp_path / "belt.json").points_mm.shape == high.points_mm.shape


@pytest.mark.parametrize(
    ("name", "text", "line"),
    [
        ("belt.csv", "", "give a plan.toml, a project.toml or a belt.json"),
        ("project.toml", 'empty = "old.json"', "no such file; for a first calibration give the plan.toml"),
        ("plan.toml", "[belt]\nwidth_mm = -3", "width_mm"),
    ],
)
def test_a_file_without_a_belt_is_refused(tmp_path, name, text, line):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=line) as error:
        read_measuring_volume(tmp_path / name)
    assert name in str(error.value)


def test_a_refusal_leaves_a_picture_beside_the_earlier_result(charuco_capture, run, tmp_path, monkeypatch):
    (tmp_path / "board.toml").write_text(BOARD)
    words = "--board", tmp_path / "board.toml", "--core", "cam0", "--out", tmp_path / "out"
    assert run("calibrate", charuco_capture.folder, *words)[0] == 0
    earlier = {path.name: path.read_bytes() for path in (tmp_path / "out").glob("[!.]*")}
    assert {"rig.json", "coverage.png", "report.html"} <= earlier.keys()
    assert "Coverage of the measuring volume" in earlier["report.html"].decode()
    assert json.loads(earlier["calibration.json"])["coverage"]["volume"] == "the whole view of cam0"

    def refuse(coverage):
        raise UncoveredVolumeError("camera cam1: the board never came to 40% of it", coverage)

    monkeypatch.setattr(calibration, "require_coverage", refuse)
    code, _, err = run("calibrate", charuco_capture.folder, *words)
    picture = tmp_path / "out" / "coverage_refused.png"
    assert code == 2
    assert err[-1].endswith(f"never came to 40% of it; {picture} shows where")
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert {name: (tmp_path / "out" / name).read_bytes() for name in earlier} == earlier
