"""The soak: its plant has every protocol, and its description of the ledger finds gaps and late records."""

import importlib
from dataclasses import replace

import pytest

from beltscape.service.project import open_project
from tests.sinks.ledgers import ledger


@pytest.fixture
def soak():
    return importlib.import_module("soak")


def test_project_has_every_protocol(soak, tmp_path):
    (tmp_path / "capture").mkdir()
    for name in ("rig.json", "reconstruction.json"):
        (tmp_path / name).write_text("{}")  # is opened by a run only
    ports = {name: 20_000 + k for k, name in enumerate(soak._TABLES)}
    path = soak.write_project(tmp_path, tmp_path / "capture", tmp_path, "fast", '"auto"', ports)
    settings = open_project(path).settings
    assert {name: getattr(settings, name).port for name in ports} == ports
    assert settings.recording.mode == "ring"
    assert settings.csv.enabled


def test_description_of_a_ledger(soak):
    """A gap of half a millimetre is found, and records that come a second later at the end than at the beginning."""
    records = ledger(140)
    whole, _, even = soak.describe_ledger(records)
    assert whole == "140 records, largest gap or overlap 0.000000 mm"
    first, last = records[:120], records[120:]
    late = [
        replace(one, wall_ns=one.wall_ns + 10**9, belt_mm=(one.belt_mm[0] + 0.5, one.belt_mm[1]))
        for one in last
    ]
    gap, metres, delays = soak.describe_ledger([*first, *late])
    assert gap.endswith("0.500000 mm")
    assert "5.998 m missing" in metres
    assert delays != even
    assert float(delays.split(", ")[-1].split(" / ")[0]) == pytest.approx(1, abs=0.01)
