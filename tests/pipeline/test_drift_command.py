"""The drift of a plant's rig: its history, the proposal in litres, taken, audited and undone; and the command."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beltscape.cli.main import main
from beltscape.core.empty_belt import Belt
from beltscape.core.errors import InputError, OutputError
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.files.rig_json import read_rig, write_rig
from beltscape.kernels import load
from beltscape.pipeline.calibrating import rig_changes
from beltscape.pipeline.calibrating.drift import assess_drift, differentiate_volume
from beltscape.pipeline.calibrating.rig_changes import take_proposal
from beltscape.service.project import open_project
from beltscape.stereo.consistency.drift import apply_drift
from tests.measure.flow.moving_belt import make_empty_belt
from tests.pipeline.drifting_plants import HEIGHT_MM, KNOCK, DriftingPlant, copy_plant, make_knocked_plant
from tests.synthetic.drifting_rigs import make_rig, make_true_rig


@pytest.fixture(scope="module")
def knocked(tmp_path_factory) -> DriftingPlant:
    return make_knocked_plant(tmp_path_factory.mktemp("drift") / "plant")


@pytest.fixture
def plant(knocked, tmp_path) -> DriftingPlant:
    """A copy of the plant that a test may change."""
    return copy_plant(knocked, tmp_path / "plant")


def measure_rise(true: Rig, rig: Rig, belt: Belt) -> float:
    """Return the mean height error of a level load, seen by the true cameras and measured by a rig."""
    x, y = np.meshgrid(np.linspace(*belt.across_mm, 9), np.linspace(*belt.along_mm, 9))
    place = np.stack([x.ravel(), y.ravel(), np.full(x.size, HEIGHT_MM)], axis=1)
    points = belt.belt_from_core.inverse().apply(place)
    seen = np.stack([true.project_into(rig, name, points) for name in rig.cameras])
    found = load().triangulate(np.stack([rig.projection(name) for name in rig.cameras]), seen, threads=1)
    return float(np.nanmean(belt.belt_from_core.apply(found)[:, 2] - HEIGHT_MM))


def find_newest(plant: DriftingPlant) -> int:
    newest = assess_drift(open_project(plant.path), Silent()).newest
    assert newest is not None
    return newest.number


def test_the_proposal_takes_back_the_error_of_the_volume(knocked) -> None:
    found = assess_drift(open_project(knocked.path), Silent())
    assert [one.document["moved"] for one in found.estimates] == ["none", "cam2"]
    assert found.proposed is not None
    drifted, belt = apply_drift(make_true_rig(), KNOCK), make_empty_belt().belt
    at_first = measure_rise(make_true_rig(), make_rig(), belt)
    before = measure_rise(drifted, make_rig(), belt) - at_first
    after = measure_rise(drifted, found.proposed, belt) - at_first
    assert abs(after) < 0.4 * abs(before)
    effect, still = found.effects[1], found.effects[0]
    assert abs(before / HEIGHT_MM + effect.share) < 2 * effect.sigma
    assert abs(after / HEIGHT_MM) < 2 * effect.sigma
    assert still.share == 0
    assert still.sigma > 0


def test_the_derivative_of_the_volume_is_that_of_measured_heights() -> None:
    seen_by_all = {"across_mm": (-120.0, 120.0), "along_mm": (-100.0, 100.0)}
    belt = replace(make_empty_belt().belt, **seen_by_all)
    gains = differentiate_volume(make_rig(), belt, HEIGHT_MM)
    for number, name in enumerate(("cam0", "cam1")):
        for index, step in ((0, 1e-4), (4, 0.05), (6, 1e-4)):
            change = np.zeros(7)
            change[index] = step
            moved = apply_drift(make_rig(), {name: change})
            rise = measure_rise(make_rig(), moved, belt) - measure_rise(make_rig(), make_rig(), belt)
            assert gains[0, 7 * number + index] * step == pytest.approx(rise / HEIGHT_MM, rel=0.1, abs=3e-5)


def test_a_proposal_is_taken_audited_and_undone(plant, capsys) -> None:
    before = (plant.folder / "rig.json").read_bytes()
    number = find_newest(plant)
    assert main(["drift", str(plant.path), "--take", str(number), "--by", "anna"]) == 0
    assert f"estimate {number} taken by anna" in capsys.readouterr().out
    taken = read_rig(plant.folder / "rig.json")
    assert taken.quality["drift"]["estimate"] == number
    assert not np.allclose(taken.cam_from_core["cam2"].rotation, make_rig().cam_from_core["cam2"].rotation)
    np.testing.assert_allclose(
        taken.cam_from_core["cam1"].translation_mm, make_rig().cam_from_core["cam1"].translation_mm
    )
    assert main(["drift", str(plant.path), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["estimates"], document["reference_ns"]) == ([], None)  # of the new rig
    assert main(["drift", str(plant.path), "--undo", "--by", "bert"]) == 0
    assert (plant.folder / "rig.json").read_bytes() == before
    log = [json.loads(line) for line in (plant.folder / "data/audit.jsonl").read_text().splitlines()]
    assert [one["what"] for one in log] == ["rig taken", "rig undone"]
    assert log[0]["rig_before"] == log[1]["rig_after"]
    kept = plant.folder / "data/rigs"  # both, so that neither is lost
    assert {path.stem for path in kept.iterdir()} == {"changes", log[0]["rig_before"], log[0]["rig_after"]}
    assert main(["drift", str(plant.path), "--undo"]) == 2
    assert "there is nothing to undo" in capsys.readouterr().err


def test_a_rig_is_put_back_where_its_change_cannot_be_kept(plant, monkeypatch) -> None:
    found, number = assess_drift(open_project(plant.path), Silent()), find_newest(plant)
    before = (plant.folder / "rig.json").read_bytes()

    def refuse(path: Path, _document: object) -> None:
        raise OutputError(f"{path}: the disk is full")

    monkeypatch.setattr(rig_changes, "write_json", refuse)
    with pytest.raises(OutputError, match=r"changes\.json: the disk is full"):
        take_proposal(plant.folder / "data", found, number, "anna")
    assert (plant.folder / "rig.json").read_bytes() == before


def test_only_the_newest_estimate_of_the_present_rig_is_taken(plant) -> None:
    found, number = assess_drift(open_project(plant.path), Silent()), find_newest(plant)
    with pytest.raises(InputError, match=f"the newest is {number}"):
        take_proposal(plant.folder / "data", found, number - 1, "anna")
    write_rig(plant.folder / "rig.json", replace(make_rig(), quality={"note": "another"}))
    with pytest.raises(InputError, match="has changed meanwhile"):
        take_proposal(plant.folder / "data", found, number, "anna")


def test_a_rig_that_is_changed_after_taking_is_not_overwritten(plant, capsys) -> None:
    number = find_newest(plant)
    assert main(["drift", str(plant.path), "--take", str(number)]) == 0
    write_rig(plant.folder / "rig.json", make_rig())
    assert main(["drift", str(plant.path), "--undo"]) == 2
    assert "has changed meanwhile" in capsys.readouterr().err


def test_the_page_shows_the_proposal_in_four_languages(plant, tmp_path, capsys) -> None:
    titles = {
        "en": "Drift of the rig", "de": "Drift des Kameraaufbaus",
        "es": "Deriva del conjunto de cámaras", "zh": "相机装置的漂移",
    }  # fmt: skip
    for language, title in titles.items():
        out = tmp_path / language
        assert main(["drift", str(plant.path), "--out", str(out), "--language", language]) == 0
        assert "Camera cam2 has moved" in capsys.readouterr().out
        page = (out / "report.html").read_text()
        assert title in page
        assert "cam2" in page
    document = json.loads((tmp_path / "en/drift.json").read_text())
    assert document["is_significant"]
    assert document["change_litres"] == pytest.approx(
        document["week_litres"] * document["estimates"][-1]["volume_percent"] / 100
    )


def test_a_plant_without_estimates_says_when_they_come(tmp_path, knocked, capsys) -> None:
    shutil.copytree(knocked.folder, tmp_path / "plant")
    write_rig(tmp_path / "plant" / "rig.json", replace(make_rig(), quality={"new": True}))
    assert main(["drift", str(tmp_path / "plant/project.toml")]) == 0
    assert "the first comes after 2 h of" in capsys.readouterr().out
