"""The endpoints of the alarms: list, journal, key figures, shelving, out of service, reset."""

from __future__ import annotations

import csv
import io
import time
from dataclasses import replace

import pytest

from beltscape.core.alarms import Alarm
from tests.service.plants import make_service

NAN = float("nan")
LOST = Alarm(
    "camera_lost:cam2", "warning", "raised", NAN, NAN, "", 1, "silent; check its cable", priority="high",
    group="images", is_first=True,
)  # fmt: skip
URL = "/api/alarms/camera_lost:cam2"
PERIOD = f"since_ms=0&until_ms={round(time.time() * 1000) + 86_400_000}"


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    """A service, and signed-in users by role."""
    made = make_service(tmp_path_factory.mktemp("service"))
    made.plant.raise_alarm(LOST)
    yield made, {role: made.browser(role) for role in ("viewer", "operator", "engineer")}
    made.history.close()
    made.access.close()


def test_the_list_has_priority_group_first_and_the_reason_of_the_default(parts):
    _, users = parts
    (alarm,) = [one for one in users["viewer"]("GET", "/api/alarms").json() if one["name"] == LOST.name]
    assert (alarm["priority"], alarm["group"], alarm["first"]) == ("high", "images", True)
    assert (alarm["consequence"], alarm["response"]) == ("major", "soon")
    assert (alarm["isa_state"], alarm["suppression"]) == ("unacknowledged", None)


def test_shelving_needs_an_operator_and_is_audited_and_ends(parts):
    made, users = parts
    body = {"reason": "cable is coming", "minutes": 30}
    assert users["viewer"]("POST", f"{URL}/shelve", json=body).status_code == 403
    assert users["operator"]("POST", "/api/alarms/nothing/shelve", json=body).status_code == 404
    assert users["operator"]("POST", f"{URL}/shelve", json={"reason": " ", "minutes": 30}).status_code == 422
    assert users["operator"]("POST", f"{URL}/shelve", json={"reason": "x", "minutes": 0}).status_code == 422
    refused = users["operator"]("POST", f"{URL}/shelve", json={"reason": "x", "minutes": 481})
    assert refused.status_code == 409 and "max_min" in refused.json()["detail"]
    assert users["operator"]("POST", f"{URL}/shelve", json=body).status_code == 200
    state = users["viewer"]("GET", "/api/state").json()
    assert state["alarms"] == []
    (hidden,) = state["hidden_alarms"]
    assert (hidden["state"], hidden["hidden_state"], hidden["isa_state"]) == ("clear", "raised", "shelved")
    assert (hidden["suppression"]["reason"], hidden["suppression"]["by"]) == (
        "cable is coming",
        "the-operator",
    )
    assert hidden["suppression"]["until_ms"] - hidden["suppression"]["since_ms"] == 30 * 60_000
    entry = made.access.audit.read_last(1)[0]
    assert (entry["what"], entry["who"]) == ("shelve_alarm", "the-operator")
    assert "camera_lost:cam2/shelve" in entry["request"]
    assert users["engineer"]("POST", f"{URL}/return_to_service").status_code == 409
    assert users["operator"]("POST", f"{URL}/unshelve").status_code == 200
    assert users["operator"]("POST", f"{URL}/unshelve").status_code == 409
    assert [one["state"] for one in users["viewer"]("GET", "/api/state").json()["alarms"]] == ["raised"]


def test_out_of_service_needs_an_engineer_also_to_end(parts):
    _, users = parts
    body = {"reason": "sent for repair"}
    assert users["operator"]("POST", f"{URL}/out_of_service", json=body).status_code == 403
    assert users["engineer"]("POST", f"{URL}/out_of_service", json=body).status_code == 200
    assert users["operator"]("POST", f"{URL}/unshelve").status_code == 409
    assert users["operator"]("POST", f"{URL}/return_to_service").status_code == 403
    assert users["engineer"]("POST", f"{URL}/return_to_service").status_code == 200


def test_a_latched_alarm_is_reset(parts):
    made, users = parts
    assert users["operator"]("POST", f"{URL}/reset").status_code == 409
    made.plant.raise_alarm(replace(LOST, name="overload", state="latched", needs_reset=True))
    assert users["operator"]("POST", "/api/alarms/overload/reset").status_code == 200
    assert made.plant.alarms["overload"].state == "clear"


def add_events(history, begin_ns: int) -> None:
    for i in range(12):
        raised = {"state": "raised", "priority": "high", "value": 1.5, "unit": "m"}
        history.add_event(
            "alarm", "overload", "raised: heavy", wall_ns=begin_ns + i * 10**10, parameters=raised
        )
    hidden = {"state": "raised", "suppression": "shelved", "suppressed_by": "test"}
    history.add_event("alarm", "empty", "raised", wall_ns=begin_ns, parameters=hidden)
    shelved = {"action": "shelved", "reason": "=1+1"}
    history.add_event("alarm", "empty", "=1+1, and, more", "ada", begin_ns + 10**12, shelved)
    history.add_event("note", "other", "no alarm", wall_ns=begin_ns)


def test_journal_csv_and_key_figures(tmp_path):
    made = make_service(tmp_path)
    viewer, begin_ns = made.browser("viewer"), 1_790_000_000 * 10**9
    add_events(made.history, begin_ns)
    period = f"since_ms={begin_ns // 10**6}&until_ms={begin_ns // 10**6 + 3_600_000}"
    first = viewer("GET", f"/api/alarms/journal?{period}&limit=10").json()
    rest = viewer("GET", f"/api/alarms/journal?{period}&after={first[-1]['number']}").json()
    assert len(first) == 10 and [one["name"] for one in rest] == ["overload", "overload", "empty", "empty"]
    newest = viewer("GET", f"/api/alarms/journal?{period}&limit=2&newest=true").json()
    assert newest == rest[:1:-1]
    own = viewer("GET", f"/api/alarms/journal?{period}&name=empty").json()
    assert [one["by"] for one in own] == ["", "ada"]
    answer = viewer("GET", f"/api/alarms/journal.csv?{period}")
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    assert len(rows) == 14 and rows[0]["time_utc"] == "2026-09-21T14:13:20.000Z"
    assert (rows[0]["state"], rows[0]["priority"], rows[0]["value"], rows[0]["unit"]) == (
        "raised",
        "high",
        "1.5",
        "m",
    )
    assert rows[-1]["text"] == "'=1+1, and, more"  # no formula for a spreadsheet
    found = viewer("GET", f"/api/alarms/statistics?{period}").json()
    assert (found["count"], found["peak_per_10_min"], found["floods"], found["chattering"]) == (
        12,
        12,
        1,
        ["overload"],
    )
    assert found["top"] == [{"name": "overload", "count": 12, "share": 1.0}]
    assert found["by_priority"]["high"] == 12
    assert viewer("GET", f"/api/alarms/statistics?since_ms=0&until_ms={400 * 86_400_000}").status_code == 422
    assert made.browser()("GET", f"/api/alarms/journal?{period}").status_code == 401
    made.history.close()
    made.access.close()
