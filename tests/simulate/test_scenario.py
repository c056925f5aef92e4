"""Scenarios: accepted and refused TOML files."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from beltscape.core.errors import InputError
from beltscape.pipeline.simulation import read_scenario
from beltscape.simulate.scenario import KINDS, Scenario


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_has_defaults_for_all_keys(kind):
    scenario = read_scenario(kind, {})
    assert scenario.kind == kind
    assert scenario.is_lit == (kind != "calibration")
    assert Scenario.model_validate(scenario.model_dump(mode="json")) == scenario  # as truth/ keeps it


def test_dead_projector_and_one_that_is_off_give_no_light():
    assert not Scenario(kind="belt_empty", speckle=False).is_lit
    assert not read_scenario("belt_empty", {"faults": {"dead_projector": True}}).is_lit


def test_paths_are_relative_to_the_folder_of_the_file(tmp_path):
    scene = tmp_path / "scenes" / "mine.toml"
    scene.parent.mkdir()
    scene.write_text(
        'kind = "module"\n[rig]\nfile = "rig"\n[module]\nfile = "../m.toml"\n'
        '[board]\nfile = "/else/b.toml"\n[projector]\npattern = "fine"\n'
    )
    scenario = read_scenario(str(scene), {})
    assert scenario.rig.file == scene.parent / "rig"
    assert scenario.module.file == scene.parent / "../m.toml"
    assert str(scenario.board.file) == "/else/b.toml"
    assert scenario.projector.pattern == "fine"
    scene.write_text('kind = "module"\n[projector]\npattern = "own/pattern.json"\n')
    assert read_scenario(str(scene), {}).projector.pattern == scene.parent / "own/pattern.json"


def test_overrides_take_precedence_over_the_file(tmp_path):
    scene = tmp_path / "mine.toml"
    scene.write_text('kind = "module"\nseed = 3\nframes = 2\n[rig]\nscale = 1.0\nheight_mm = 800\n')
    scenario = read_scenario(str(scene), {"seed": 5, "rig": {"scale": 0.25, "file": "here.json"}, "tof": {}})
    assert (scenario.seed, scenario.frames) == (5, 2)
    assert (scenario.rig.scale, scenario.rig.height_mm) == (0.25, 800)
    assert str(scenario.rig.file) == "here.json"  # as one who types it means it
    assert scenario.tof is not None


@pytest.mark.parametrize(
    ("toml", "line"),
    [
        ('kind = "module"\nsede = 3\n', "unknown key sede; did you mean seed?"),
        ('kind = "module"\nfrmaes = 3\n', "unknown key frmaes; did you mean frames?"),
        ('kind = "modul"\n', "kind = 'modul': must be 'calibration', 'module'"),
        ("seed = 1\n", "kind is missing"),
        ('kind = "module"\n[rig]\nheigth_mm = 3\n', "unknown key rig.heigth_mm"),
        ('kind = "module"\nrig = 3\n', "rig = 3: must be"),
        ('kind = "module"\nframes = 0\n', "frames = 0: must be greater than or equal to 1"),
        ('kind = "module"\n[rig]\nscale = 2\n', "rig.scale = 2: must be less than or equal to 1"),
        ('kind = "module"\n[rig]\naim_mm = 900\n', "aim_mm = 900: must be below height_mm = 744"),
        ('kind = "module"\n[projector]\nposition_mm = [0, 0, 0]\n', "z must be over the belt"),
        ('kind = "module"\n[board]\ndepth_mm = [700, 600]\n', "the first must be the smaller one"),
        ('kind = "module"\n[[faults.dirt]]\ncamera = "a"\nspecks_px = [[1, 1, 0]]\n', "faults.dirt[0]"),
        ('kind = "module"\n[[faults.dirt]]\ncamera = "a"\n', "give specks_px, or a coverage above 0"),
        ('kind = "module"\n[[faults.dirt]]\ncamera = "a"\ncoverage = 5\n', "coverage = 5: must be"),
        ('kind = "module"\n[[faults.encoder]]\nkind = "lost"\n', "must be 'reversed', 'frozen'"),
        ('kind = "module"\n[[faults.projector]]\npower = -1\n', "faults.projector[0].power = -1: must be"),
        ('kind = "module"\n[[faults.defocus]]\nsigma_px = 2\n', "faults.defocus[0].camera is missing"),
    ],
)
def test_invalid_scene_is_refused_in_one_line_naming_the_file(tmp_path, toml, line):
    scene = tmp_path / "mine.toml"
    scene.write_text(toml)
    with pytest.raises(InputError) as refusal:
        read_scenario(str(scene), {"rig": {"pitch_um": 3.0}})
    said = str(refusal.value)
    assert said.startswith(f"{scene}: ")
    assert line in said
    assert "\n" not in said


def test_unknown_scene_is_refused_with_the_known_ones():
    with pytest.raises(InputError) as refusal:
        read_scenario("belt", {})
    assert str(refusal.value).startswith("belt: no such scene")
    assert all(kind in str(refusal.value) for kind in KINDS)


def test_missing_scene_file_is_refused():
    with pytest.raises(InputError, match=r"gone\.toml: no such file"):
        read_scenario("gone.toml", {})


@pytest.mark.parametrize(
    "values",
    [
        {"seed": -1},
        {"seed": 2**63},
        {"frames": 100_001},
        {"gain_spread": 1.0},
        {"ambient": -0.1},
        {"rig": {"auxiliaries": 0}},
        {"rig": {"size_px": (63, 64)}},
        {"rig": {"height_mm": float("inf")}},
        {"rig": {"distortion": (0.0, float("nan"), 0.0, 0.0, 0.0)}},
        {"board": {"tilt_deg": 80}},
        {"motion": {"frames_per_s": 0}},
        {"motion": {"speed_mm_s": float("nan")}},
        {"faults": {"over_exposure": [{"camera": "cam0", "factor": 0}]}},
    ],
)
def test_bounds(values):
    with pytest.raises(ValidationError):
        Scenario.model_validate({"kind": "belt_empty", **values})


def test_scenario_stays_as_it_is():
    with pytest.raises(ValidationError):
        Scenario(kind="module").seed = 2  # pyrefly: ignore[read-only]
