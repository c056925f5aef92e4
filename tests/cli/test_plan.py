"""``beltscape plan`` as a command."""

from __future__ import annotations

import contextlib
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest

from beltscape.cli import main as program
from beltscape.core.geometry.pose import Pose
from beltscape.files.rig_json import read_rig
from tests.optional import require


@pytest.fixture(autouse=True)
def desk(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def planned(tmp_path_factory) -> tuple[Path, str, str]:
    """The folder of a plan with all defaults, standard output and standard error."""
    folder, printed, warned = tmp_path_factory.mktemp("plan") / "out", io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(warned):
        assert program.main(["plan", "--out", str(folder)]) == 0
    return folder, printed.getvalue(), warned.getvalue()


def test_papers_rig(planned):
    folder, out, err = planned
    assert out.startswith("Eq. 26    718.3 mm above the idlers' vertices at 57.00°\n")
    assert "stated angle" not in err
    assert {p.name for p in folder.iterdir()} == {
        *("plan.json", "rig.json", "report.html", ".beltscape.json")
    }


def test_json_and_files_agree_and_the_rig_is_the_planned_one(capsys, planned):
    assert program.main(["plan", "--out", "out", "--json"]) == 0
    for name in ("plan.json", "rig.json", "report.html"):  # a second run gives the same bytes
        assert Path("out", name).read_bytes() == (planned[0] / name).read_bytes()
    printed = json.loads(capsys.readouterr().out)
    written = json.loads(Path("out/plan.json").read_text(encoding="utf-8"))
    assert {**printed, "report": None} == {**written, "report": None}
    rig, plan = read_rig(Path("out/rig.json")), written["rig"]
    core_from_world = Pose.of(plan["core_from_world"]["rotation"], plan["core_from_world"]["translation_mm"])
    assert rig.core == plan["core"]
    for name, camera in plan["cameras"].items():
        pose = rig.cam_from_core[name] @ core_from_world
        np.testing.assert_allclose(pose.center_mm, camera["position_mm"], atol=1e-9)
        spot = rig.cameras[name].project(pose.apply(np.array(plan["target_mm"])))
        np.testing.assert_allclose(spot, rig.cameras[name].center_px, atol=1e-6)


def test_report_is_self_contained(planned):
    page = (planned[0] / "report.html").read_text(encoding="utf-8")
    drawings = re.findall(r"<svg [^>]*data-px-per-mm.*?</svg>", page, flags=re.DOTALL)
    assert len(drawings) == 6  # three, each for wide and narrow screens
    for text in (page, *drawings):
        assert re.findall(r"https?://(?!www\.w3\.org/2000/svg)[^\"'\s)]+", text) == []
        assert not re.search(r"(?:src|href)=[\"'](?!data:|#)", text)
    from xml.dom.minidom import parseString

    for drawing in drawings:
        assert require(parseString(drawing).documentElement).tagName == "svg"
    assert "718.3" in page


def test_options_go_before_the_file(capsys):
    Path("plan.toml").write_text(
        "frames_per_point = 2\n[belt]\nwidth_mm = 1200\nspan_mm = 1100\nspeed_m_s = 3\n[rig]\nauxiliaries = 3\n"
    )
    assert program.main(["plan", "--plan", "plan.toml", "--speed", "1.5", "--json"]) == 0
    settings = json.loads(capsys.readouterr().out)["settings"]
    assert (settings["belt"]["width_mm"], settings["belt"]["speed_m_s"]) == (1200, 1.5)
    assert (settings["rig"]["auxiliaries"], settings["frames_per_point"]) == (3, 2)


def test_every_option_reaches_a_setting(capsys):
    from beltscape.cli.commands.plan import _OPTIONS
    from beltscape.plan.settings import PlanSettings

    known = PlanSettings().model_dump()
    for option in _OPTIONS:
        place = known
        for key in option.key.split("."):
            assert key in place
            place = place[key]
        if place is not None:  # the help's default is the model's
            words = " ".join(f"{v:g}" for v in place) if isinstance(place, tuple) else f"{place:g}"
            assert f"({words})" in option.help


@pytest.mark.parametrize(
    ("words", "toml", "line"),
    [
        (["--focal", "50"], "", "max_height_mm = 3000: a lens of 50 mm sees the span of 780 mm only from"),
        (["--focal", "-1"], "", "plan: camera.focal_mm = -1.0: must be greater than or equal to 1"),
        (["--span", "900"], "", "plan: belt = "),
        (["--height", "500"], "", "height_mm = 500: a lens of 8 mm does not see the span of 780 mm"),
        (["--plan", "plan.toml"], "[belt]\nwidht_mm = 3\n", "plan.toml: unknown key belt.widht_mm"),
        (["--plan", "plan.toml"], "belt = 3\n", "plan.toml: belt = 3"),
        (["--plan", "gone.toml"], "", "gone.toml: no such file"),
        (["--plan", "plan.toml"], "[belt\n", "plan.toml: not TOML"),
        (["--baseline", "9000"], "", "baseline_mm = 9000: auxiliaries would see past the belt"),
    ],
)
def test_what_cannot_be_is_one_line(capsys, words, toml, line):
    if toml:
        Path("plan.toml").write_text(toml)
    assert program.main(["plan", *words]) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert said[0].startswith(f"beltscape: {line}")


def test_help_imports_nothing_heavy():
    import subprocess
    import sys

    code = (
        "import argparse, sys\nimport beltscape.cli.commands.plan as p\n"
        "p.add_arguments(argparse.ArgumentParser())\n"
        "print(sorted({'numpy', 'pydantic', 'cv2'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
