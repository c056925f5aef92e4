"""The paper's numbers name quantities that exist, and rows hold what was measured against them."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.geometry.pose import Pose
from beltscape.evaluate.paper.dimensions import (
    Dimension,
    largest_error_mm,
    map_paper_names,
    read_paper_numbers,
    tabulate_dimensions,
)
from beltscape.simulate.scenario import Scenario
from beltscape.simulate.scene_assembly import SimulatedScene
from beltscape.simulate.truth_files import describe_module
from beltscape.target.module import Base, Cube, Cylinder, Module, Sphere

CUBES = ("step:a-b height_difference", "step:b-c height_difference")
STEP = Dimension(row=12, name="step", of=CUBES, actual_mm=20, table2_mm=19.5795)
EDGE = Dimension(row=1, name="edge", of=("a edge",), actual_mm=100, table2_mm=100.6125, table3_mm=108.1)


def test_every_row_is_a_true_dimension_of_the_module():
    module = SimulatedScene(Scenario(kind="module")).module
    assert module is not None
    known = {
        f"{e['name']} {e['quantity']}": e["true_mm"]
        for e in describe_module(module, Pose.identity())["features"]
    }
    numbers = read_paper_numbers()
    assert [d.row for d in numbers.dimension] == list(range(1, 13))
    for dimension in numbers.dimension:
        assert all(known[name] == dimension.actual_mm for name in dimension.of)


def test_the_errors_are_the_published_ones():
    published = [0.61, 0.79, 0.02, 2.25, 2.29, 1.69, 2.54, 1.53, 4.14, 1.22, 0.99, 2.10]
    percent = [100 * abs(d.table2_mm / d.actual_mm - 1) for d in read_paper_numbers().dimension]
    np.testing.assert_allclose(percent, published, atol=0.006)


def test_means_of_several_and_what_is_missing():
    some = {"a edge": (99.5, 0.2), CUBES[0]: (20.1, 0.3)}
    all_of_them = {**some, CUBES[1]: (20.3, 0.4)}
    rows = tabulate_dimensions([EDGE, STEP], {"some": some, "all": all_of_them, "none": {}})
    assert rows[0].error_mm("some") == pytest.approx(-0.5)
    assert np.isnan(rows[1].error_mm("some"))
    assert rows[1].measured_mm["all"] == pytest.approx(20.2)
    assert rows[1].sigma_mm["all"] == pytest.approx(np.sqrt(0.125))
    assert largest_error_mm(rows, "some") == pytest.approx(0.5)
    assert np.isnan(largest_error_mm(rows, "none"))


def test_another_modules_names_are_those_of_the_paper():
    here = (0.0, 0.0)
    module = Module(
        name="other",
        base=Base(size_mm=(285, 200, 10)),
        cube=(Cube(name="a", edge_mm=80, center_mm=here), Cube(name="b", edge_mm=100, center_mm=here)),
        sphere=(Sphere(name="ball", diameter_mm=30, center_mm=here),),
        cylinder=(Cylinder(name="rod", diameter_mm=20, height_mm=90, center_mm=here),),
    )
    assert map_paper_names(module) == {
        "a": "cube80",
        "b": "cube100",
        "ball": "sphere30",
        "rod": "cylinder20",
        "step:b-a": "step:cube100-cube80",
    }
