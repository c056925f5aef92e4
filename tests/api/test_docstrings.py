"""The examples in the docstrings of the verbs run in one session, and a type checker flags wrong words."""

from __future__ import annotations

import doctest
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any, get_args

import pytest

import beltscape as bs
from beltscape.api.calibration import LensChoice
from beltscape.api.measuring import LumpOptions, VolumeOptions
from beltscape.core.geometry.lens import MODELS
from beltscape.measure.lumps.settings import LumpSettings
from beltscape.measure.volume.settings import VolumeSettings
from beltscape.stereo.settings import PRESETS, Preset
from tests.once import make_once
from tests.synthetic.demo import DEMO
from tests.synthetic.small_demo import make_small_demo
from tests.thorough import list_cases

VERBS = [name for name in bs.__all__ if name[0].islower() or name in ("FlowMeter", "Reconstructor")]
CHECKER = Path(sys.executable).parent / "pyrefly"


@pytest.fixture(scope="module")
def found(rig: bs.Rig, scenes: dict[str, Any], belt: bs.Belt) -> dict[str, Any]:
    """What the examples stand on: the demo's rig, images, depths and belt."""
    loaded, module = scenes["belt_loaded"], scenes["module"]
    return {
        "bs": bs, "demo": DEMO, "rig": rig, "belt": belt, "depth": loaded.depth, "depth_mm": loaded.depth.depth_mm,
        "empty": scenes["belt_empty"].depth, "image0": loaded.frame.images["cam0"],
        "image1": loaded.frame.images["cam1"], "depth_module": module.depth,
        "image_module": module.frame.images["cam0"], "cloud": bs.point_cloud(loaded.depth, rig),
    }  # fmt: skip


@pytest.mark.parametrize("name", list_cases(VERBS, set(VERBS) - {"measure_features", "calibrate"}))
def test_every_verb_has_an_example_that_runs(
    name: str,
    found: dict[str, Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    if name == "calibrate":
        found = {**found, "demo": make_once(tmp_path_factory, "four_camera_demo", make_small_demo)}
    monkeypatch.chdir(tmp_path)
    bs.write_rig(found["rig"], "rig.json")
    bs.write_belt(found["belt"], "belt.json")
    bs.write_depth(found["depth"], "depth_loaded/000")
    text = getattr(bs, name).__doc__ or ""
    assert ">>> " in text
    test = doctest.DocTestParser().get_doctest(text, dict(found), name, None, 0)
    output = list[str]()
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    assert runner.run(test, out=output.append).failed == 0, "".join(output)


def test_typed_words_are_those_that_are_taken() -> None:
    assert set(get_args(Preset)) == set(PRESETS)
    assert set(get_args(LensChoice)) == {"auto", *MODELS}
    assert set(VolumeOptions.__annotations__) == set(VolumeSettings.model_fields)
    assert set(LumpOptions.__annotations__) == set(LumpSettings.model_fields)


@pytest.mark.skipif(not CHECKER.exists(), reason="pyrefly is not installed; `make dev` brings it")
def test_a_type_checker_flags_wrong_words(tmp_path: Path) -> None:
    (tmp_path / "pyrefly.toml").write_text("")  # a project's rules, not those of a single file
    (tmp_path / "caller.py").write_text(
        "import beltscape as bs\n\n\n"
        "def work(rig: bs.Rig, depth: bs.DepthMap, belt: bs.Belt) -> None:\n"
        '    bs.Reconstructor(rig, preset="fast")\n'
        "    bs.measure_lumps(depth, rig, oversize_mm=60)\n"
        "    bs.measure_volume(depth, belt, rig, cell_mm=5)\n"
        '    bs.FlowMeter(rig, belt, direction="+y")\n'
        '    bs.Reconstructor(rig, preset="fats")\n'
        "    bs.measure_lumps(depth, rig, oversize=60)\n"
        "    bs.measure_volume(depth, belt, rig, cell=5)\n"
        '    bs.FlowMeter(rig, belt, direction="y")\n'
        '    bs.calibrate("a", "b", lens_model="fish")\n'
    )
    done = subprocess.run(
        [CHECKER, "check", "--output-format", "min-text", "--python-interpreter-path", sys.executable, "caller.py"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    lines = {int(line.split(":")[1]) for line in done.stdout.splitlines() if line.startswith("ERROR")}
    assert lines == {9, 10, 11, 12, 13}, done.stdout


def test_the_manual_lists_every_public_name() -> None:
    tool = runpy.run_path(str(Path(__file__).resolve().parents[2] / "tools/write_python_reference.py"))
    text = tool["PAGE"].read_text("utf-8")
    assert tool["fill_page"](text) == text, "run python tools/write_python_reference.py"
    assert all(f"`bs.{name}" in text for name in bs.__all__)
