"""The drift of a rig served beside a running plant: where that refuses a change, nothing is changed or lost."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest

from beltscape.core.errors import InputError
from beltscape.core.progress import Silent
from beltscape.pipeline.calibrating.rig_changes import read_changes
from beltscape.service.access import Access
from beltscape.service.drift import ServedDrift
from beltscape.service.reloader import Reload
from tests.pipeline.drifting_plants import DriftingPlant, make_knocked_plant
from tests.service.access.sample_app import CHEAP

REFUSAL = "project.toml: density.kg_m3 = -1: must be at least 0"


class Reloads:
    """The reload of a running plant, which may refuse."""

    def __init__(self) -> None:
        self.by: list[str] = []
        self.refuses = False

    def __call__(self, by: str, _address: str) -> Reload:
        if self.refuses:
            raise InputError(REFUSAL)
        self.by.append(by)
        return Reload((), ())


@pytest.fixture
def served(tmp_path: Path):
    plant, reloads = make_knocked_plant(tmp_path / "plant"), Reloads()
    access = Access(plant.folder / "data", cost=CHEAP)
    yield plant, reloads, partial(ServedDrift, plant.path, plant.folder / "data", access)
    access.close()


def list_files(plant: DriftingPlant) -> tuple[bytes, list[dict[str, object]], list[str]]:
    """Return the rig's file, the changes, and what is audited."""
    log = plant.folder / "data" / "audit.jsonl"
    audited = [json.loads(line)["what"] for line in log.read_text().splitlines()] if log.is_file() else []
    return (
        (plant.folder / "rig.json").read_bytes(),
        list(map(dict, read_changes(plant.folder / "data"))),
        audited,
    )


def test_neither_taking_nor_undoing_is_lost_where_the_plant_refuses(served) -> None:
    plant, reloads, serve = served
    drift = serve(reloads, Silent())
    number, first = drift.read()["newest"], list_files(plant)
    reloads.refuses = True
    with pytest.raises(InputError, match=r"density\.kg_m3 = -1.*; the rig stays as it was"):
        drift.take(number, "anna", "")
    assert list_files(plant) == first
    reloads.refuses = False
    drift.take(number, "anna", "")
    taken = list_files(plant)
    assert [taken[0] != first[0], [one["action"] for one in taken[1]], taken[2]] == [
        True,
        ["taken"],
        ["rig taken"],
    ]
    reloads.refuses = True
    with pytest.raises(InputError, match=r"density\.kg_m3 = -1.*; the rig stays as it was"):
        drift.undo("bert", "")
    assert list_files(plant) == taken
    reloads.refuses = False
    drift.undo("bert", "")
    undone = list_files(plant)
    assert undone[0] == first[0]
    assert undone[2] == ["rig taken", "rig undone"]
    assert reloads.by == ["anna", "bert"]


def test_a_rig_that_is_replaced_while_the_plant_refuses_is_not_overwritten(served) -> None:
    plant, _, serve = served
    another = b"{}"

    def replace_and_refuse(_by: str, _address: str) -> Reload:
        (plant.folder / "rig.json").write_bytes(another)
        raise InputError(REFUSAL)

    drift = serve(replace_and_refuse, Silent())
    with pytest.raises(InputError, match=r"density\.kg_m3 = -1.*; .*rig\.json: has changed meanwhile"):
        drift.take(drift.read()["newest"], "anna", "")
    assert (plant.folder / "rig.json").read_bytes() == another
