"""The budget of a plant's history, with its certificate, its zeros and its encoder; and the command."""

from __future__ import annotations

import json
import math

import pytest

from beltscape.cli.main import main
from beltscape.core.alarm_catalogue import ENCODER_MOTION
from beltscape.core.errors import InputError
from beltscape.core.findings import Finding
from beltscape.core.progress import Silent
from beltscape.pipeline.auditing.paid_tonne import (
    PaidTonneOptions,
    compute_plant_budget,
    make_budget_document,
)
from beltscape.pipeline.auditing.total import parse_total
from beltscape.pipeline.certifying.certificates import IssueOptions, issue_certificate
from beltscape.pipeline.certifying.material_test import evaluate_test_file
from beltscape.service.project import open_project
from beltscape.sinks.historian import Historian, StoredFinding
from beltscape.sinks.settings import HistorySettings
from tests.pipeline.certifying.plants import BEGIN_NS, make_tested_plant

HOUR_NS = 3600 * 10**9
PRODUCT = '[[products]]\nname = "limestone"\ndensity_kg_m3 = 1600\nsigma_kg_m3 = 10\nmoisture_percent = 4\n'


@pytest.fixture
def plant(tmp_path):
    made, _ = make_tested_plant(tmp_path / "plant")
    made.path.write_text(made.path.read_text() + PRODUCT)
    return made


def compute(plant, total: str = "all", **options: float):
    return compute_plant_budget(open_project(plant.path), parse_total(total), PaidTonneOptions(**options))


def list_parts(found) -> dict[str, float]:
    return {one.key: one.sigma for one in found.paid.budget.contributions}


def test_parts_of_the_history_add_up_as_they_are_correlated(plant) -> None:
    found = compute(plant)
    volume_mm3 = math.fsum(one.volume_mm3 for one in plant.records)
    tonnes = volume_mm3 * 1.6e-9
    parts = list_parts(found)
    assert found.paid.amount == pytest.approx(tonnes)
    assert parts == pytest.approx(
        {
            "edges": 0.3 * 0.004 * tonnes,
            "holes": 0.4 * 0.004 * tonnes,
            "geometry": math.sqrt(0.75) * 0.004 * tonnes,
            "matching": 30 * 400 * math.sqrt(len(plant.records)) * 1.6e-9,
            "density": volume_mm3 * 10e-12,
        }
    )
    assert found.paid.largest == "density"
    notes = make_budget_document(found)["notes"]
    assert notes == ["no_scale", "no_speed", "wet"]


def test_certificate_encoder_and_moisture_are_in_it(plant) -> None:
    evaluated = evaluate_test_file(plant.folder / "material_test.toml", open_project(plant.path), Silent())
    now_ms = BEGIN_NS // 10**6
    issue_certificate(plant.folder / "data", evaluated, IssueOptions("belt 4", "meier", now_ms))
    historian = Historian(plant.folder / "data", HistorySettings(reserve_mib=1))
    slip = Finding(ENCODER_MOTION, 0.0012, 0.0005, 0.005, "")
    fault = Finding(ENCODER_MOTION, 0.5, 0.0, 0.005, "", text="slips", effect="degraded")
    historian.add_findings(
        [StoredFinding(BEGIN_NS + HOUR_NS * n, one) for n, one in enumerate((slip, fault, slip))]
    )
    historian.add_event("zero", "set", "+0.1", "anna", BEGIN_NS + 100 * 10**9)
    historian.close()
    found = compute(plant, moisture_sigma_percent=0.2)
    span, factor = evaluated.test.find("span_factor"), evaluated.test.find("mass_factor")
    assert span is not None
    assert factor is not None
    parts, tonnes = list_parts(found), found.paid.amount
    assert parts["scale"] == pytest.approx(span.budget.sigma / span.value * tonnes)
    assert parts["speed"] == pytest.approx(math.hypot(0.0012, 0.0005) * tonnes)
    assert parts["moisture"] == pytest.approx(0.002 / 0.96 * tonnes)
    assert found.zeros == 1
    document = make_budget_document(found)
    assert document["certificate"] == "2026-0001"
    assert document["test_sigma_percent"] == pytest.approx(100 * factor.budget.sigma / factor.value)
    assert document["notes"] == []


def test_the_scale_cancels_in_a_density_of_the_material_test(plant) -> None:
    evaluated = evaluate_test_file(plant.folder / "material_test.toml", open_project(plant.path), Silent())
    factor = evaluated.test.find("mass_factor")
    assert factor is not None
    document = {"results": [{"key": "mass_factor", "value": 1600.2, "sigma": 3.0},
                            {"key": "span_factor", "value": 1.0, "sigma": 0.01}]}  # fmt: skip
    issued = issue_certificate(plant.folder / "data", evaluated, IssueOptions("belt 4", "meier", 0))
    sealed = json.loads(issued.path.read_text())
    sealed["document"]["results"] = document["results"]
    issued.path.write_text(json.dumps(sealed))
    assert "scale" not in list_parts(compute(plant))


def test_the_command_prints_and_writes_one_page(plant, tmp_path, capsys) -> None:
    words = ["budget", str(plant.path), "year:2026", "--out", str(tmp_path / "out")]
    for language in ("en", "de", "es", "zh"):
        assert main([*words, "--language", language]) == 0
        assert "lower it: bulk density" in capsys.readouterr().out
    page = (tmp_path / "out/report.html").read_text()
    assert "计费吨的不确定度" in page
    assert json.loads((tmp_path / "out/budget.json").read_text())["largest"] == "density"
    assert main([*words, "--moisture-sigma", "99"]) == 2
    assert "must be 0 to 20 percent" in capsys.readouterr().err


def test_a_total_without_sums_is_one_line(plant) -> None:
    with pytest.raises(InputError, match="keeps no sums of year:2019"):
        compute(plant, "year:2019")
