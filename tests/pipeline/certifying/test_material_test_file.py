"""A material test by its file and a plant's history, against its truth; what does not fit is one clear line."""

from __future__ import annotations

import json
from datetime import timedelta

import pytest

from beltscape.cli.main import main
from beltscape.core.errors import InputError, MeasureError
from beltscape.core.progress import Silent
from beltscape.pipeline.certifying.material_test import evaluate_test_file
from beltscape.service.project import open_project
from tests.pipeline.certifying.plants import (
    BEGIN,
    DENSITY,
    SPAN,
    ZERO_MM2,
    SimulatedPlant,
    make_tested_plant,
)


@pytest.fixture(scope="module")
def tested(tmp_path_factory: pytest.TempPathFactory):
    return make_tested_plant(tmp_path_factory.mktemp("tested") / "plant")


def evaluate(plant, path, reporter=None):
    return evaluate_test_file(path, open_project(plant.path), reporter or Silent())


def test_truth_lies_within_the_stated_uncertainty(tested) -> None:
    plant, path = tested
    reporter = Silent()
    found = evaluate(plant, path, reporter)
    truth = {"span_factor": SPAN, "bulk_density": DENSITY, "mass_factor": SPAN * DENSITY}
    for key, true in truth.items():
        result = found.test.find(key)
        assert result is not None
        assert abs(result.value - true) < result.budget.expanded, key
        assert result.budget.sigma < 0.01 * true
    assert found.test.observations.zero is not None
    zero = found.test.observations.zero
    assert abs(zero.area_mm2 - ZERO_MM2) < 4 * zero.sigma_mm2
    assert zero.sigma_mm2 < 10
    assert found.document["notes"] == []
    assert reporter.warnings == []
    assert set(found.document["applies"]) == {"rig", "empty", "settings", "networks", "program"}


def test_the_same_by_times_as_by_records(tested) -> None:
    plant, path = tested
    text = path.read_text()
    for one in plant.lines:
        records = one.rpartition("records = [")[2].rstrip("]\n").split(", ")
        begin, end = (
            BEGIN + timedelta(seconds=0.2 * int(n) + d) for n, d in zip(records, (-0.1, 0.1), strict=True)
        )
        text = text.replace(
            f"records = [{', '.join(records)}]", f"begin = {begin.isoformat()}\nend = {end.isoformat()}"
        )
    by_times = path.with_name("by_times.toml")
    by_times.write_text(text)
    assert "records" not in text
    one, other = (evaluate(plant, file).document for file in (path, by_times))
    assert one["results"] == other["results"]


def test_the_command_writes_page_and_figures(tested, capsys, tmp_path) -> None:
    plant, path = tested
    words = [
        "certify",
        "material",
        str(path),
        "--project",
        str(plant.path),
        "--out",
        str(tmp_path / "out"),
        "--json",
    ]
    assert main(words) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["certificate"] is None
    kept = json.loads((tmp_path / "out/test.json").read_text())
    assert kept["results"] == document["results"]
    page = (tmp_path / "out/report.html").read_text()
    assert "no certificate: it is not signed" in page
    assert not (plant.folder / "data/certificates").exists()


def change(plant: SimulatedPlant, path, old: str, new: str):
    changed = path.with_name("changed.toml")
    text = path.read_text()
    assert old in text
    changed.write_text(text.replace(old, new, 1))
    return changed


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("revolutions = 3", "revolutions = 4", "3.00 revolutions of 40 m, not 4"),
        ("belt_length_m = 40.0", "", "belt_length_m is missing"),
        ("mass_kg", "weight_kg", "unknown key"),
        ("sigma_percent = 0.05\nsigma_kg = 1.0", "", "no mass is known exactly"),
        ("records = [301, 460]", "records = [900001, 900002]", "has no record there"),
        ("records = [301, 460]", "records = [460, 301]", "the first is after the last"),
        ("records = [301, 460]", "", "nothing says where it was measured"),
        ("records = [301, 460]", "begin = 2026-11-21T08:00:00\nend = 2026-11-21T09:00:00", "timezone"),
        ("records = [301, 460]", 'flow = "nothing"', "flow.json: no such file"),
        ("sigma_kg_m3 = 8.0", "sigma_kg_m3 = 0", "greater than 0"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_one_line(tested, old, new, says) -> None:
    plant, path = tested
    with pytest.raises((InputError, MeasureError)) as caught:
        evaluate(plant, change(plant, path, old, new))
    assert says in str(caught.value)
    assert str(path.parent) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_run_with_missing_belt_is_refused(tmp_path) -> None:
    plant = SimulatedPlant(tmp_path / "plant")
    plant.add_run("half")
    plant.pass_belt([0.0], standing="missing", reason="no frames")
    first, last = 1, len(plant.records)
    plant.lines[0] = f'[[runs]]\nload = "half"\nmass_kg = 1\nrecords = [{first}, {last}]\n'
    plant.add_run("full")
    with pytest.raises(InputError, match=r"0\.6 % of its belt was not measured"):
        evaluate(plant, plant.write())


def test_a_run_that_begins_or_ends_under_load_is_warned_of(tmp_path) -> None:
    plant, path = make_tested_plant(tmp_path / "plant")
    reporter = Silent()
    evaluate(plant, change(plant, path, "records = [301, 460]", "records = [310, 460]"), reporter)
    assert [line for line in reporter.warnings if "material lay on the belt at its begin" in line]


def test_runs_of_another_rig_are_refused(tmp_path) -> None:
    plant, path = make_tested_plant(tmp_path / "plant")
    (plant.folder / "rig.json").write_text('{"rig": 2}')
    with pytest.raises(InputError, match=r"\(half\): was measured with another rig than the project has now"):
        evaluate(plant, path)
