"""The HTTP interface: state, history, export and operators' actions."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from itertools import pairwise
from math import nan

import numpy as np
import pyarrow.parquet as pq
import pytest

from beltscape.core.alarms import Alarm, AlarmState
from beltscape.core.events import CameraHealth
from beltscape.core.translatable_message import Message
from tests.service.feeder import make_heights
from tests.service.plants import BEGIN_NS, OPEN, STEP_NS, make_service

MS = BEGIN_NS // 1_000_000
LATER = MS + 60_000


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    made = make_service(tmp_path_factory.mktemp("works"), 30, access=OPEN)
    yield made
    made.history.close()


@pytest.fixture(scope="module")
def viewer(full):
    return full.browser()


@pytest.fixture(scope="module")
def operator(full):
    return full.browser("operator")


def overload(state: AlarmState = "raised", name: str = "overload") -> Alarm:
    return Alarm(name, "critical", state, 107.0, nan, "%", BEGIN_NS)


def test_state_is_in_plant_units(viewer, full):
    state = viewer("GET", "/api/state").json()
    totals = full.plant.ledger.totals
    assert state["totals"]["volume_m3"] == pytest.approx(totals.volume_mm3 * 1e-9)
    assert state["totals"]["valid_m"] == pytest.approx(30 * 0.48)
    assert state["frames"]["speed_m_s"] == pytest.approx(2.4)
    assert [camera["name"] for camera in state["cameras"]] == ["cam1", "cam2", "cam3", "cam4", "cam5"]
    assert state["record"] == 30


def test_unknown_values_are_null(tmp_path):
    empty = make_service(tmp_path, access=OPEN)
    state = empty.browser()("GET", "/api/state").json()
    assert (
        state["flow"]["volume_m3_h"] is None and state["frames"]["age_s"] is None and state["record"] is None
    )
    empty.history.close()


def test_page_names_the_user(viewer, operator):
    page = viewer("GET", "/api/page").json()
    assert (page["plant"], page["role"], page["language"]) == ("Belt 7", "viewer", "en")
    assert operator("GET", "/api/page").json()["user"] == "the-operator"


def test_series_add_up_to_the_totals(viewer, full):
    series = viewer("GET", "/api/series", params={"since_ms": MS, "until_ms": LATER, "points": 50}).json()
    assert sum(series["volume_m3"]) == pytest.approx(full.plant.ledger.totals.volume_mm3 * 1e-9, rel=1e-4)
    assert {len(values) for values in series.values() if isinstance(values, list)} == {
        len(series["start_ms"])
    }
    assert None in series["flow_m3_h"]  # after the last record nothing is known


def test_records_are_paged_without_gap_or_repeat(viewer):
    seen, after = [], 0
    while page := viewer(
        "GET", "/api/records", params={"since_ms": MS, "until_ms": LATER, "limit": 7, "after": after}
    ).json():
        seen += page
        after = page[-1]["number"]
    assert [record["number"] for record in seen] == list(range(1, 31))
    assert all(a["to_m"] == b["from_m"] for a, b in pairwise(seen))


def test_section_of_a_record(viewer):
    section = viewer("GET", "/api/section", params={"number": 3}).json()
    expected = make_heights(2 * 480.0, 96).mean(axis=0)
    np.testing.assert_allclose([h for h in section["height_mm"] if h is not None], expected, atol=0.1)
    assert viewer("GET", "/api/section", params={"number": 999}).status_code == 404


def test_events_and_days_are_listed(viewer, full):
    full.history.add_event("alarm", "overload", "raised", wall_ns=BEGIN_NS + 5)
    events = viewer("GET", "/api/events", params={"since_ms": MS, "until_ms": LATER}).json()
    assert [(event["kind"], event["name"], event["text"]) for event in events] == [
        ("alarm", "overload", "raised")
    ]
    days = viewer("GET", "/api/days", params={"since_ms": MS - 86_400_000, "until_ms": LATER}).json()
    assert sum(day["records"] for day in days) == 30


def test_exports_match_the_history(viewer, full):
    period = {"since_ms": MS, "until_ms": LATER}
    text = viewer("GET", "/api/export", params=period)
    assert "attachment" in text.headers["content-disposition"]
    rows = list(csv.DictReader(io.StringIO(text.text)))
    table = pq.read_table(
        io.BytesIO(viewer("GET", "/api/export", params=period | {"format": "parquet"}).content)
    )
    records = full.history.records(BEGIN_NS, BEGIN_NS + 30 * STEP_NS, 100)
    assert [int(row["number"]) for row in rows] == table["number"].to_pylist() == [r.number for r in records]
    assert table["volume_mm3"].to_pylist() == [r.volume_mm3 for r in records]
    assert all(len(section) == 201 for section in table["section_height_mm"].to_pylist())


def test_an_export_of_nothing_is_an_empty_table(viewer):
    period = {"since_ms": 0, "until_ms": 1000}
    assert len(viewer("GET", "/api/export", params=period).text.splitlines()) == 1
    parquet = viewer("GET", "/api/export", params=period | {"format": "parquet"}).content
    assert pq.read_table(io.BytesIO(parquet)).num_rows == 0


@pytest.mark.parametrize("path", ["series", "records", "events", "days", "export"])
@pytest.mark.parametrize(
    "period",
    [
        {"since_ms": 5, "until_ms": 4},
        {"since_ms": -1, "until_ms": 4},
        {"since_ms": 0, "until_ms": 10**18},
        {"since_ms": "now", "until_ms": 4},
        {},
    ],
)
def test_invalid_periods_are_refused(viewer, path, period):
    answer = viewer("GET", f"/api/{path}", params=period)
    assert answer.status_code == 422
    assert "detail" in answer.json()


@pytest.mark.parametrize(
    "path",
    ["/api/series?points=1", "/api/series?points=5000", "/api/records?limit=0", "/api/events?limit=9999"],
)
def test_result_counts_are_bounded(viewer, path):
    assert viewer("GET", f"{path}&since_ms=0&until_ms=1").status_code == 422


def test_pictures_have_name_and_time(viewer):
    answer = viewer("GET", "/api/cameras/cam1/picture")
    assert answer.headers["content-type"] == "image/webp" and answer.content[8:12] == b"WEBP"
    assert answer.headers["beltscape-frame"] == "000026"
    assert viewer("GET", "/api/cameras/cam9/picture").status_code == 404


def test_acknowledging_requires_an_operator_and_an_open_alarm(viewer, operator, full):
    full.plant.raise_alarm(overload())
    path = "/api/alarms/overload/acknowledge"
    assert viewer("POST", path).status_code == 403
    assert operator("POST", path).json() == {"by": "the-operator"}
    assert full.live_state.take_snapshot().alarms[0].state == "acknowledged"
    assert operator("POST", path).status_code == 409
    assert operator("POST", "/api/alarms/nonsense/acknowledge").status_code == 404


def test_alarm_names_may_contain_a_camera(operator, full):
    full.plant.raise_alarm(overload(name="camera_lost:cam 3/ü"))
    assert operator("POST", "/api/alarms/camera_lost:cam3/acknowledge").status_code == 404
    full.plant.raise_alarm(overload(name="camera_lost:cam3"))
    assert operator("POST", "/api/alarms/camera_lost%3Acam3/acknowledge").status_code == 200


def test_keeping_the_recording_requires_an_operator(viewer, operator):
    assert viewer("POST", "/api/recording/keep", json={"reason": "lump"}).status_code == 403
    assert operator("POST", "/api/recording/keep", json={"reason": "lump"}).status_code == 200
    assert operator("POST", "/api/recording/keep", json={"reason": ""}).status_code == 422
    assert operator("POST", "/api/recording/keep", json={"reason": "x", "more": 1}).status_code == 422


def test_an_unreadable_history_gives_503(tmp_path):
    made = make_service(tmp_path, 3, access=OPEN)
    made.history.close()
    viewer = made.browser()
    for path in ("series", "records", "events", "days", "export"):
        answer = viewer("GET", f"/api/{path}", params={"since_ms": MS, "until_ms": LATER})
        assert answer.status_code == 503, path
    assert viewer("GET", "/api/state").status_code == 200


def test_every_response_is_described(full):
    paths = full.app.openapi()["paths"]
    ours = {path: methods for path, methods in paths.items() if not path.startswith("/api/access")}
    assert len(ours) >= 11
    for path, methods in ours.items():
        for description in methods.values():
            assert {"200", "401", "403", "429"} <= set(description["responses"]), path


def test_the_api_requires_login(tmp_path):
    made = make_service(tmp_path)
    stranger = made.browser()
    for path in ("/api/state", "/api/page", "/metrics", "/api/openapi.json", "/api/cameras/cam1/picture"):
        assert stranger("GET", path).status_code == 401, path
    assert stranger("GET", "/", headers={"accept": "text/html"}).status_code == 303
    made.history.close()


def test_earlier_totals_are_shown_from_the_start(tmp_path):
    first = make_service(tmp_path, 4)
    first.history.close()
    again = make_service(tmp_path, access=OPEN)
    assert again.browser()("GET", "/api/state").json()["totals"]["valid_m"] == pytest.approx(4 * 0.48)
    again.history.close()


def test_messages_carry_the_parts_of_their_texts(tmp_path):
    made = make_service(tmp_path, 2, access=OPEN)
    message = Message("no image for 4 s; check its power", "silent", seconds=4)
    made.live_state.on_health({"cam1": CameraHealth("cam1", "lost", 1, 2, 0.0, nan, message)})
    made.plant.raise_alarm(replace(overload(), name="camera_lost:cam1", detail=message))
    made.history.add_event(
        "alarm", "encoder_silent", "raised", wall_ns=BEGIN_NS, parameters={"state": "raised", "value": 5.0}
    )
    state = made.browser()("GET", "/api/state").json()
    assert (state["cameras"][0]["cause"], state["cameras"][0]["values"]) == ("silent", {"seconds": 4})
    assert (state["alarms"][0]["cause"], state["alarms"][0]["values"]) == ("silent", {"seconds": 4})
    (event,) = made.browser()("GET", f"/api/events?since_ms={MS}&until_ms={LATER}").json()
    assert event["parameters"] == {"state": "raised", "value": 5.0}
    made.history.close()
