"""The interface of production: who may change what, what is refused, totals as the ledger has them."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from time import time_ns

import pytest

from beltscape.core.errors import InputError, OutputError
from beltscape.pipeline.live.production import ProductionControl
from beltscape.production.settings import ReportSettings, ScaleSettings
from beltscape.service.production.figures import ProductionFigures
from beltscape.service.production.reports import ReportWriter
from beltscape.service.protocols import ServedPlant
from tests.service.access.sample_app import Browser
from tests.service.plants import ServiceParts, add_production, make_service
from tests.service.production.plants import make_control

CONTROLS: list[ProductionControl] = []
"""The control behind the interface."""
TRUCK = "=truck;1"
EVER = {"since_ms": 0, "until_ms": 4_102_444_800_000}


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceParts]:
    folder = tmp_path_factory.mktemp("production")
    made = make_service(folder)
    figures = ProductionFigures(make_control(made.history), ScaleSettings())
    CONTROLS[:] = [figures.control]
    add_production(
        made, figures, ReportWriter(ReportSettings(), figures, made.history, folder, "Quay 4", print)
    )
    (folder / "reports" / "20260101T0000Z_day.html").write_text("<p>a report</p>")
    yield made
    made.history.close()


@pytest.fixture(scope="module")
def operator(parts: ServiceParts) -> Browser:
    return parts.browser("operator")


@pytest.fixture(scope="module")
def viewer(parts: ServiceParts) -> Browser:
    return parts.browser("viewer")


@pytest.fixture(scope="module")
def truck(parts: ServiceParts, operator: Browser) -> list[int]:
    """Load a truck while five records pass; return their numbers."""
    assert operator("POST", "/api/production/product", json={"name": "coal"}).status_code == 200
    assert operator("POST", "/api/production/product", json={"name": "coal"}).status_code == 409
    started = operator("POST", "/api/production/batch/start", json={"name": TRUCK, "product": "ore"})
    assert started.status_code == 200
    before = parts.history.ledger_end.number
    for _ in range(5):
        parts.plant.step()
    assert operator("GET", "/api/production").json()["batch"]["totals"]["records"] == 5
    assert operator("POST", "/api/production/batch/stop").status_code == 200
    for _ in range(2):
        parts.plant.step()
    return list(range(before + 1, before + 6))


def get_truck(browser: Browser) -> dict:
    batches = browser("GET", "/api/production/batches", params=EVER).json()
    (batch,) = (one for one in batches if one["name"] == TRUCK)
    return batch


def test_a_viewer_reads_and_changes_nothing(parts: ServiceParts, viewer: Browser) -> None:
    product = viewer("GET", "/api/production").json()["product"]
    assert product in ("ore", "coal")
    for path, body in (
        ("product", {"name": "coal"}), ("batch/start", {"name": "a"}), ("batch/stop", None), ("scale", {"kg": 1}),
    ):  # fmt: skip
        assert viewer("POST", f"/api/production/{path}", json=body).status_code == 403
    assert viewer("GET", "/api/production").json()["product"] == product
    assert parts.browser()("GET", "/api/production").status_code == 401


def test_a_batch_has_the_totals_of_its_records(
    parts: ServiceParts, operator: Browser, truck: list[int]
) -> None:
    batch = get_truck(operator)
    records = [r for r in parts.history.records(0, 1 << 62) if r.batch == batch["number"]]
    assert [r.number for r in records] == truck
    assert {r.product for r in records} == {"ore"}
    assert batch["complete"]
    assert (batch["started_by"], batch["ended_by"]) == ("the-operator", "the-operator")
    volume = sum(r.volume_mm3 for r in records) * 1e-9
    assert batch["totals"]["volume_m3"] == pytest.approx(volume)
    assert batch["totals"]["mass_t"] == pytest.approx(volume * 1.6)
    sigma = sum(r.sigma_mm3 for r in records) * 1e-9  # its common part is not known: all of it
    assert batch["totals"]["sigma_m3"] == pytest.approx(sigma)
    assert batch["totals"]["mass_sigma_t"] == pytest.approx(
        ((sigma * 1.6) ** 2 + (volume * 0.04) ** 2) ** 0.5
    )


@pytest.mark.usefixtures("truck")
def test_batches_are_a_table_that_no_spreadsheet_runs(viewer: Browser) -> None:
    answer = viewer("GET", "/api/production/batches.csv", params=EVER)
    (row,) = (one for one in csv.DictReader(io.StringIO(answer.text)) if TRUCK in one["name"])
    assert row["name"] == f"'{TRUCK}"
    assert row["records"] == "5"
    assert row["products"] == "ore"


def test_refusals_say_why(operator: Browser) -> None:
    def refuse(path: str, body: object, code: int) -> str:
        answer = operator("POST", f"/api/production/{path}", json=body)
        assert answer.status_code == code
        return str(answer.json()["detail"])

    assert "there are ore, coal" in refuse("product", {"name": "gold"}, 409)
    assert "no batch is open" in refuse("batch/stop", None, 409)
    assert "printable" in refuse("batch/start", {"name": " \t"}, 409)
    refuse("batch/start", {"name": "x" * 61}, 422)
    refuse("scale", {"kg": float(2**60)}, 422)
    refuse("scale", {"kg": -1}, 422)
    assert "future" in refuse("scale", {"kg": 1, "at_ms": 4_102_444_800_000}, 409)


@pytest.mark.usefixtures("truck")
def test_a_typed_counter_gives_the_mass_of_the_batch(operator: Browser) -> None:
    batch = get_truck(operator)
    mass_kg = batch["totals"]["mass_t"] * 1000
    for at, kg in (("started_ms", 5000.0), ("ended_ms", 5000.0 + 1.01 * mass_kg)):
        assert (
            operator("POST", "/api/production/scale", json={"kg": kg, "at_ms": batch[at]}).status_code == 200
        )
    batch = get_truck(operator)
    assert batch["scale"]["mass_t"] == pytest.approx(1.01 * mass_kg / 1000)
    assert batch["scale"]["sigma_t"] == pytest.approx(
        0.005 * batch["scale"]["mass_t"], rel=0.1
    )  # not interpolated
    assert batch["scale"]["density_kg_m3"] == pytest.approx(1616)
    assert not batch["scale"]["disagrees"]
    assert batch["scale"]["moisture_percent"] == pytest.approx(
        100 * (1 - 1536 / batch["scale"]["density_kg_m3"])
    )


def test_shifts_and_days_add_up(parts: ServiceParts, viewer: Browser) -> None:
    now_ms = time_ns() // 1_000_000
    period = {"since_ms": now_ms - 3_600_000, "until_ms": now_ms + 60_000}
    for kind in ("shift", "day"):
        found = viewer("GET", "/api/production/periods", params={**period, "kind": kind}).json()
        assert sum(one["totals"]["records"] for one in found) == parts.history.ledger_end.number
    far = {"since_ms": 0, "until_ms": now_ms}
    assert viewer("GET", "/api/production/periods", params=far).status_code == 422
    assert viewer("GET", "/api/production/trends").json() == []


def test_reports_are_served_alone(parts: ServiceParts, viewer: Browser) -> None:
    assert viewer("GET", "/api/reports").json() == []
    assert viewer("GET", "/api/reports/20260102T0000Z_day").status_code == 404
    for key in ("..", "x", "20260101T0000Z_day%2f..", "20260101T0000Z_dayx"):
        assert viewer("GET", f"/api/reports/{key}").status_code in (400, 404, 422)


def test_a_report_has_a_policy_of_its_own(viewer: Browser) -> None:
    report = viewer("GET", "/api/reports/20260101T0000Z_day")
    assert report.text == "<p>a report</p>"
    assert "sandbox" in report.headers["content-security-policy"]
    assert "script-src" not in report.headers["content-security-policy"]
    assert "unsafe-inline" not in viewer("GET", "/api/production").headers["content-security-policy"]


def test_protocols_change_what_the_page_changes(parts: ServiceParts, monkeypatch: pytest.MonkeyPatch) -> None:
    control = CONTROLS[0]
    plant = ServedPlant(parts.live_state, parts.history, lambda *_: False, production=control)
    plant.change_product("coal", "opc")
    plant.start_batch("ship", "ore", "opc")
    state = plant.read_state()
    assert (state.product, state.batch, state.products) == ("ore", "ship", ("ore", "coal"))
    with pytest.raises(InputError, match="batch ship is open"):
        plant.start_batch("another", "", "opc")
    plant.stop_batch("opc")

    def fail(*_: object) -> None:
        raise OutputError("the disk is full")

    monkeypatch.setattr(control.history, "change_product", fail)
    with pytest.raises(InputError, match="nothing was changed: the disk is full"):
        plant.change_product("coal", "opc")
    assert plant.read_state().product == "ore"
    with pytest.raises(InputError, match="neither products nor batches"):
        ServedPlant(parts.live_state, parts.history, lambda *_: False).stop_batch("opc")


def test_without_products_the_interface_stays_away(tmp_path: Path) -> None:
    bare = make_service(tmp_path)
    assert bare.browser("viewer")("GET", "/api/production").status_code == 404
    bare.history.close()
