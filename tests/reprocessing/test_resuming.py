"""What a re-processing does again and what it keeps: changes of settings and recordings, failures, invalid input.

The measurement itself is replaced by one that takes no time.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from beltscape.core.empty_belt import Belt
from beltscape.core.geometry.camera import Camera
from beltscape.core.progress import Reporter
from beltscape.measure.belt.settings import GivenBelt
from beltscape.reprocessing import measuring
from beltscape.reprocessing import run as module
from beltscape.reprocessing.pieces import PieceResult, PieceTimes
from beltscape.sinks.historian.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.reprocessing.conftest import FRAMES, RECORDINGS, STEP_MM
from tests.reprocessing.test_joining import measure
from tests.reprocessing.test_run import read_records

EACH = FRAMES // RECORDINGS
"""Frames of a recording."""


@pytest.fixture(autouse=True)
def measured(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """Give the entries of a belt with a steady load; return the numbers of the pieces that were measured."""
    numbers: list[int] = []

    def measure_piece(parcel: object, piece: module.Piece) -> PieceResult:
        del parcel
        numbers.append(piece.number)
        return PieceResult(tuple(measure(piece)), (), PieceTimes(0.1, 0.1, 0.1, 1.0, 10, len(piece.frames)))

    monkeypatch.setattr(module, "measure_piece", measure_piece)
    yield numbers


def test_a_second_run_does_nothing_and_a_density_measures_nothing(
    reprocess, recorded_plant, tmp_path
) -> None:
    first = reprocess()
    files = {path: path.read_bytes() for path in (tmp_path / "store").glob("*.json")}
    again = reprocess()
    assert (again["changed"], again["measured_now"]) == (False, 0)
    assert again["totals"] == first["totals"]
    assert {path: path.read_bytes() for path in files if path.name == "reprocessing.json"} == {
        path: data for path, data in files.items() if path.name == "reprocessing.json"
    }
    lighter = _write_project(recorded_plant, tmp_path, "kg_m3 = 1500", "kg_m3 = 750")
    changed = reprocess(project=lighter)
    assert (changed["changed"], changed["measured_now"]) == (True, 0)
    assert changed["totals"]["volume_mm3"] == first["totals"]["volume_mm3"]
    assert changed["totals"]["mass_kg"] == pytest.approx(first["totals"]["mass_kg"] / 2, rel=1e-12)


def _write_project(plant: Path, folder: Path, old: str, new: str) -> Path:
    for name in ("rig.json", "belt.json", "empty"):
        (folder / name).symlink_to(plant / name)
    path = folder / "project.toml"
    path.write_text((plant / "project.toml").read_text().replace(old, new))
    return path


def test_other_settings_of_measuring_need_a_store_of_their_own(
    reprocess, run, recorded_plant, tmp_path
) -> None:
    reprocess("moving")
    other = _write_project(recorded_plant, tmp_path, "[density]", "[flow]\ncell_mm = 9\n[density]")
    code, out, err = run(
        "reprocess", recorded_plant / "moving", "--project", other, "--out", tmp_path / "store"
    )  # fmt: skip
    assert (code, out) == (2, "")
    assert "give another folder with --out" in err[-1]


def test_a_run_goes_on_on_a_processor_that_fits_the_empty_belt_with_other_last_bits(
    reprocess, recorded_plant, tmp_path, monkeypatch
) -> None:
    project = _write_project(recorded_plant, tmp_path, "belt.json", "empty/000")
    reprocess(project=project)
    fit = measuring.read_empty_belt

    def fit_elsewhere(path: Path, reporter: Reporter, given: GivenBelt) -> tuple[Belt, Camera]:
        belt, camera = fit(path, reporter, given)
        return replace(belt, noise_mm=float(np.nextafter(belt.noise_mm, np.inf))), camera

    monkeypatch.setattr(measuring, "read_empty_belt", fit_elsewhere)
    again = reprocess(project=project)
    assert (again["changed"], again["measured_now"]) == (False, 0)


@pytest.mark.thorough
def test_another_empty_belt_needs_a_store_of_its_own(reprocess, run, recorded_plant, tmp_path) -> None:
    (tmp_path / "first").mkdir()
    reprocess("moving", project=_write_project(recorded_plant, tmp_path / "first", "belt.json", "empty/000"))
    other = _write_project(recorded_plant, tmp_path, "belt.json", "empty")
    (tmp_path / "empty").unlink()
    shutil.copytree(recorded_plant / "empty" / "000", tmp_path / "empty")
    depth = tmp_path / "empty" / "depth.tiff"
    changed = cv2.imread(str(depth), cv2.IMREAD_UNCHANGED)
    assert changed is not None
    changed[0, 0] = np.nan
    cv2.imwrite(str(depth), changed)
    code, out, err = run(
        "reprocess", recorded_plant / "moving", "--project", other, "--out", tmp_path / "store"
    )
    assert (code, out) == (2, "")
    assert "another rig, empty belt" in err[-1]


def test_a_recording_that_comes_later_measures_only_what_it_touches(
    reprocess, recorded_plant, tmp_path
) -> None:
    source = tmp_path / "source"
    shutil.copytree(recorded_plant / "recordings", source)
    last = max((source / "all").iterdir())
    shutil.move(last, tmp_path / last.name)
    assert reprocess(source)["pieces"] == 2
    shutil.move(tmp_path / last.name, last)
    grown = reprocess(source)
    assert grown["pieces"] == 3
    assert grown["measured_now"] >= 1  # the new one, and those whose lead-out reaches into it
    reprocess(source, store="fresh")
    assert read_records(tmp_path / "store" / "history") == read_records(tmp_path / "fresh" / "history")


def test_a_piece_that_cannot_be_measured_is_missing_belt_and_tried_again(
    reprocess, recorded_plant, tmp_path, monkeypatch
) -> None:
    measure_piece = module.measure_piece

    def fail_once(parcel, piece):
        if piece.number == 1:
            raise MemoryError("no memory")
        return measure_piece(parcel, piece)

    monkeypatch.setattr(module, "measure_piece", fail_once)
    answer = reprocess()
    assert answer["failed"] == [
        {"piece": f"all/{piece_name(recorded_plant)} frames 003 to 005", "reason": "MemoryError: no memory"}
    ]
    assert answer["standings"]["missing"] == pytest.approx(EACH * STEP_MM)
    monkeypatch.setattr(module, "measure_piece", measure_piece)
    again = reprocess()
    assert (again["measured_now"], again["failed"], again["standings"]["missing"]) == (1, [], 0.0)


def piece_name(plant: Path) -> str:
    """Return the name of the second recording."""
    return sorted((plant / "recordings" / "all").iterdir())[1].name


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--workers", 0), "--workers 0"),
        (("--piece-frames", 3), "--piece-frames 3"),
    ],
)
def test_invalid_options_are_refused_in_one_line(run, recorded_plant, tmp_path, options, message) -> None:
    code, out, err = run(
        "reprocess", recorded_plant / "moving", "--project", recorded_plant / "project.toml", "--out",
        tmp_path / "store", *options,
    )  # fmt: skip
    assert (code, out) == (2, "")
    assert message in err[-1]


def test_a_source_without_recordings_is_refused(run, recorded_plant, tmp_path) -> None:
    (tmp_path / "nothing").mkdir()
    code, _, err = run(
        "reprocess", tmp_path / "nothing", "--project", recorded_plant / "project.toml", "--out", tmp_path / "store"
    )  # fmt: skip
    assert code == 2
    assert "nothing" in err[-1]


def test_products_follow_the_plants_own_history(reprocess, recorded_plant, tmp_path) -> None:
    products = (
        '[[products]]\nname = "coal"\ndensity_kg_m3 = 800\n[[products]]\nname = "ore"\ndensity_kg_m3 = 2000\n'
    )
    project = _write_project(
        recorded_plant, tmp_path, "[density]\nkg_m3 = 1500\nsigma_kg_m3 = 30\n", products
    )
    assert {record[-1] for record in _list_products(reprocess(project=project), tmp_path)} == {"coal"}
    second = sorted((recorded_plant / "recordings" / "all").iterdir())[1].name
    began = datetime.strptime(second[7:], "%Y%m%dT%H%M%SZ").replace(tzinfo=UTC)
    historian = Historian(tmp_path / "data", HistorySettings(reserve_mib=1))
    historian.production.change_product("ore", "anna", int(began.timestamp()) * 10**9)
    changed = reprocess(project=project)
    historian.close()
    assert changed["measured_now"] == 0
    assert [record[-1] for record in _list_products(changed, tmp_path)] == ["coal"] * EACH + ["ore"] * (
        FRAMES - EACH
    )


def _list_products(answer: dict[str, Any], folder: Path) -> list[tuple[int, str]]:
    historian = Historian(folder / "store" / "history", HistorySettings(reserve_mib=1))
    records = historian.records(0, 2**62, 1000)
    historian.close()
    assert len(records) == answer["totals"]["records"]
    return [(record.number, record.product) for record in records]
