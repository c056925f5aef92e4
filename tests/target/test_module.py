"""The calibration module's description in module.toml."""

from __future__ import annotations

import pytest

from beltscape.core.errors import InputError
from beltscape.target.module import Cube, Cylinder, Sphere, read_module

TEXT = """name = "small"
[base]
size_mm = [285, 200, 10]
[[sphere]]
name = "sphere70"
diameter_mm = 70
center_mm = [-30.0, 50]
[[cube]]
name = "cube100"
edge_mm = 100
center_mm = [85.0, -42.5]
[[cube]]
name = "cube40"
edge_mm = 40
center_mm = [0, 1]
[[cylinder]]
name = "post"
diameter_mm = 20
height_mm = 90
center_mm = [-118.0, 68.0]
"""


def test_module_lists_its_features_in_order(tmp_path):
    (tmp_path / "module.toml").write_text(TEXT)
    module = read_module(tmp_path / "module.toml")
    assert module.name == "small"
    assert module.base.size_mm == (285, 200, 10)
    assert module.features == (
        Cube(name="cube100", edge_mm=100, center_mm=(85, -42.5)),
        Cube(name="cube40", edge_mm=40, center_mm=(0, 1)),
        Sphere(name="sphere70", diameter_mm=70, center_mm=(-30, 50)),
        Cylinder(name="post", diameter_mm=20, height_mm=90, center_mm=(-118, 68)),
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[base]\nsize_mm = [285, 200, 10]\n", "", "base is missing"),
        ("size_mm = [285, 200, 10]", "size_mm = [285, 200]", "base.size_mm[2] is missing"),
        ("edge_mm = 100", "edge_mm = 0", "cube[0].edge_mm = 0: must be greater than 0"),
        (
            "edge_mm = 100",
            "edge_mm = 0.1",
            "cube[0].edge_mm = 0.1: cannot be the size of a module's solid in mm (2 to 2000); in metres? write 100",
        ),
        (
            "size_mm = [285, 200, 10]",
            "size_mm = [0.285, 0.2, 0.01]",
            "base.size_mm[0] = 0.285: cannot be the side of a module's base in mm (5 to 5000); in metres? write 285",
        ),
        (
            "edge_mm = 100",
            'edge_mm = "100"',
            "cube[0].edge_mm = '100': must be a number, without quotation marks",
        ),
        ("diameter_mm = 70", "diameter_mm = inf", "sphere[0].diameter_mm = inf: must be a finite number"),
        ("height_mm = 90\n", "", "cylinder[0].height_mm is missing"),
        ('"cube40"', '"cube100"', "the name cube100 is used twice; give every feature its own name"),
        ('"post"', '"base"', "the name base is used twice; give every feature its own name"),
        ("[[cylinder]]", "[[cone]]", "unknown key cone; known: name, base, cube, sphere, cylinder"),
    ],
)
def test_invalid_file_is_refused_naming_the_key(tmp_path, old, new, message):
    path = tmp_path / "module.toml"
    assert old in TEXT
    path.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        read_module(path)
    assert str(error.value) == f"{path}: {message}"
