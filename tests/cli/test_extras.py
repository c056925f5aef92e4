"""The lean install: without the extras' libraries the core works, and a command that needs one says what to type."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from beltscape.core.errors import EXTRAS, describe_missing_library
from tests.once import make_once
from tests.synthetic.demo import DEMO
from tests.synthetic.small_demo import make_small_demo

ROOT = Path(__file__).resolve().parents[2]
WITHOUT = f"""
import sys
from importlib.abc import MetaPathFinder

class Absent(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {sorted(sum(EXTRAS.values(), ()))!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Absent())
"""


def run_without_extras(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", WITHOUT + code], capture_output=True, text=True, check=False)


def test_every_module_but_the_service_and_the_renderer_loads():
    done = run_without_extras("""
import pkgutil
from importlib import import_module
import beltscape
apart = (
    "beltscape.service", "beltscape.simulate", "beltscape.kernels._native",
    "beltscape.protocols.mqtt.connection", "beltscape.protocols.mqtt.publisher",
    "beltscape.protocols.mqtt.json_channel", "beltscape.protocols.mqtt.sparkplug", "beltscape.protocols.opcua",
    "beltscape.protocols.outputs", "beltscape.protocols.outputs", "beltscape.site",
    "beltscape.commissioning",
)
for module in pkgutil.walk_packages(beltscape.__path__, "beltscape."):
    if not module.name.startswith(apart):
        import_module(module.name)
""")
    assert done.stderr == ""
    assert done.returncode == 0


@pytest.mark.thorough
def test_images_become_depth_and_a_page_without_extras(tmp_path, tmp_path_factory):
    demo = make_once(tmp_path_factory, "four_camera_demo", make_small_demo)
    done = run_without_extras(f"""
from beltscape.cli.main import main
scene, rig, out = {str(demo / "module")!r}, {str(demo / "truth" / "rig.json")!r}, {str(tmp_path)!r}
assert main(["reconstruct", scene, "--rig", rig, "--preset", "fast", "--out", out + "/depth"]) == 0
assert main(["view", out + "/depth/000", "--out", out + "/view.html"]) == 0
""")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "view.html").stat().st_size > 100_000


@pytest.mark.parametrize(
    ("words", "says"),
    [
        pytest.param(
            ["simulate", str(ROOT / "examples/02_simulate/module_on_belt.toml"), "--out", "OUT"],
            "pip install 'beltscape[simulate]'",
            marks=pytest.mark.thorough,
        ),
        (["run", "PROJECT"], "pip install 'beltscape[live]'"),
        pytest.param(
            ["view", "SCENE", "--rerun"], "pip install 'beltscape[viewer]'", marks=pytest.mark.thorough
        ),
        (
            [
                "reconstruct",
                str(DEMO / "module"),
                "--rig",
                str(DEMO / "truth" / "rig.json"),
                "--cloud",
                "laz",
                "--out",
                "OUT",
            ],
            "pip install 'beltscape[export]'",
        ),
    ],
)
def test_a_command_says_what_to_type(words, says, tmp_path):
    given = [str(tmp_path / word) if word in ("OUT", "PROJECT") else word for word in words]
    done = run_without_extras(f"from beltscape.cli.main import main\nsys.exit(main({given!r}))")
    assert done.returncode == 2
    assert says in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_every_extra_is_declared_with_its_libraries():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert set(EXTRAS) <= set(project["optional-dependencies"])
    for extra, libraries in EXTRAS.items():
        declared = " ".join(project["optional-dependencies"][extra])
        assert any(library in declared or library in ("rerun", "gi") for library in libraries)


def test_a_library_of_no_extra_stays_an_internal_error():
    assert describe_missing_library(ModuleNotFoundError("No module named 'numpy'", name="numpy")) is None
