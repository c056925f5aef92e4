"""The public Python interface: its names, and the cost of importing them."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import beltscape

PUBLIC = [
    "Belt", "BeltProfile", "BeltscapeError", "Camera", "DepthMap", "FlowMeter", "FlowRecord", "FrameSet", "HeightMap",
    "PointCloud", "Pose", "Reconstructor", "Rig", "calibrate", "demo_folder", "learn_belt",
    "measure_features", "measure_lumps", "measure_volume", "point_cloud", "read_belt",
    "read_capture", "read_depth", "read_rig", "scale_rig", "write_belt",
    "write_cloud", "write_depth", "write_ply", "write_rig",
]  # fmt: skip

HEAVY = ["cv2", "scipy", "pydantic", "matplotlib", "rich", "jinja2", "tifffile"]


def modules_after(code: str) -> set[str]:
    """Top-level names in sys.modules of a fresh interpreter after ``code``."""
    ending = "\nimport sys\nprint('\\n'.join(sys.modules), file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code + ending], capture_output=True, text=True, check=True)
    return {line.split(".")[0] for line in done.stderr.splitlines()}


def test_the_public_names_are_pinned():
    assert sorted(beltscape.__all__) == PUBLIC
    assert dir(beltscape) == sorted(beltscape.__all__)


@pytest.mark.parametrize("name", PUBLIC)
def test_every_public_name_is_there_and_says_what_it_is(name):
    thing = getattr(beltscape, name)
    assert thing.__name__ == name
    assert thing.__doc__


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match=r"module 'beltscape' has no attribute 'Rigg'"):
        getattr(beltscape, "Rigg")  # noqa: B009


def test_the_version_is_a_version():
    assert re.fullmatch(r"\d+\.\d+\.\d+", beltscape.__version__)


def test_importing_beltscape_imports_nothing_but_the_standard_library():
    loaded = modules_after("import beltscape")
    assert "beltscape" in loaded
    assert loaded.isdisjoint([*HEAVY, "numpy"])


def test_the_types_are_those_of_the_names():
    stub = Path(beltscape.__file__).with_name("__init__.pyi").read_text(encoding="utf-8")
    assert re.findall(r'^    "(\w+)",$', stub, re.MULTILINE) == PUBLIC
    home = {
        name: module
        for module, names in re.findall(r"^from (\S+) import (?:\(([^)]*)\)|.*)", stub, re.MULTILINE)
        for name in re.findall(r"\w+", names)
    }
    assert all(vars(beltscape)["_HOME"][name] == module for name, module in home.items())


def test_the_vocabulary_imports_numpy_only():
    loaded = modules_after(
        "import beltscape\nfor name in beltscape.__all__:\n"
        "    if beltscape._HOME[name].startswith('beltscape.core'): getattr(beltscape, name)"
    )
    assert "numpy" in loaded
    assert loaded.isdisjoint(HEAVY)


@pytest.mark.parametrize("words", [["--help"], ["--version"], ["calibrate", "--help"], ["check", "--help"]])
def test_asking_for_help_imports_nothing_heavy(words):
    loaded = modules_after(
        f"from beltscape.cli.main import main\ntry:\n    main({words!r})\nexcept SystemExit:\n    pass"
    )
    assert "beltscape" in loaded
    assert loaded.isdisjoint([*HEAVY, "numpy"])


def test_the_citation_names_the_same_version():
    citation = (Path(__file__).resolve().parents[1] / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {beltscape.__version__}\n" in citation
