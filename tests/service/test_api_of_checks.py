"""The HTTP interface of checks, maintenance and zero, with its roles."""

from __future__ import annotations

from math import nan

from beltscape.core.findings import Finding
from beltscape.core.translatable_message import Message
from beltscape.sinks.historian import StoredFinding
from tests.service.findings import DIRT, PLACE
from tests.service.plants import BEGIN_NS, make_service

MS = BEGIN_NS // 1_000_000
LATER = MS + 60_000


def test_checks_and_their_series_are_for_engineers(tmp_path):
    made = make_service(tmp_path, 2)
    unknown = Finding("zero_shift", nan, nan, 2.0, "mm")
    made.plant.send_findings([DIRT, unknown])
    made.history.add_findings([StoredFinding(BEGIN_NS + k * 1_000_000_000, DIRT) for k in range(20)])
    engineer, operator = made.browser("engineer"), made.browser("operator")
    one, other = engineer("GET", "/api/checks").json()
    assert (one["check"], one["subject"], one["fault"], one["cause"]) == ("dirt", "cam2", True, "dirt")
    assert one["values"] == {"area": 6.2, "taken": 40}
    assert one["place"] == [*PLACE] and one["effect"] == "degraded"
    assert other["value"] is None and other["fault"] is False and other["place"] is None
    assert engineer("GET", "/api/checks/stored").json() == [{"check": "dirt", "subject": "cam2", "unit": "%"}]
    query = f"since_ms={MS}&until_ms={MS + 40_000}&points=4"
    series = engineer("GET", f"/api/checks/series?check=dirt&subject=cam2&{query}").json()
    assert series["mean"] == [6.2, 6.2, None, None] and series["limit"][0] == 2.0
    assert series["effect"] == ["degraded", "degraded", "none", "none"] and sum(series["faults"]) == 20
    assert engineer("GET", f"/api/checks/series?check=dirt&{query}").status_code == 404
    for path in ("/api/checks", "/api/checks/stored", f"/api/checks/series?check=dirt&subject=cam2&{query}"):
        assert operator("GET", path).status_code == 403
    made.history.close()


def test_maintenance_is_for_operators_and_audited(tmp_path):
    made = make_service(tmp_path, 3)
    viewer, operator = made.browser("viewer"), made.browser("operator")
    body = {"reason": "cleaning", "minutes": 15}
    assert viewer("POST", "/api/maintenance/begin", json=body).status_code == 403
    for wrong in ({}, {"reason": ""}, {**body, "minutes": 0}, {**body, "minutes": 1e9}, {**body, "more": 1}):
        assert operator("POST", "/api/maintenance/begin", json=wrong).status_code == 422
    assert operator("POST", "/api/maintenance/end").status_code == 409
    assert operator("POST", "/api/maintenance/begin", json=body).json() == {"by": "the-operator"}
    state = viewer("GET", "/api/state").json()
    assert state["maintenance"]["reason"] == "cleaning" and state["maintenance"]["by"] == "the-operator"
    assert state["flow"]["volume_m3_h"] is None and state["flow"]["standing"] == "missing"
    assert operator("POST", "/api/maintenance/end").status_code == 200
    assert viewer("GET", "/api/state").json()["maintenance"] is None
    written = [(one["what"], one["who"]) for one in made.access.audit.read_last(20)]
    assert ("begin_maintenance", "the-operator") in written and ("end_maintenance", "the-operator") in written
    made.history.close()


def test_images_are_learned_anew_by_engineers_and_it_is_audited(tmp_path):
    made = make_service(tmp_path, 2)
    assert made.browser("operator")("POST", "/api/images/learn").status_code == 403
    assert made.plant.learned_by == []
    assert made.browser("engineer")("POST", "/api/images/learn").json() == {"by": "the-engineer"}
    assert made.plant.learned_by == ["the-engineer"]
    written = [(one["what"], one["who"]) for one in made.access.audit.read_last(20)]
    assert written.count(("learn_images", "the-engineer")) == 1
    made.history.close()


def test_zero_is_measured_confirmed_and_audited_by_engineers(tmp_path):
    made = make_service(tmp_path, 2)
    engineer, operator = made.browser("engineer"), made.browser("operator")
    for path, body in (("measure", None), ("set", {"number": 7})):
        assert operator("POST", f"/api/zero/{path}", json=body).status_code == 403
    measured = engineer("POST", "/api/zero/measure").json()
    assert (measured["number"], measured["offset_mm"], measured["limit_mm"]) == (7, 0.42, 2.0)
    assert made.plant.zeros == []
    for wrong in ({}, {"number": 0}, {"number": 7, "offset_mm": 1.0}):
        assert engineer("POST", "/api/zero/set", json=wrong).status_code == 422
    assert engineer("POST", "/api/zero/set", json={"number": 6}).status_code == 409
    assert engineer("POST", "/api/zero/set", json={"number": 7}).json() == {"by": "the-engineer"}
    assert made.plant.zeros == [(6, "the-engineer"), (7, "the-engineer")]
    written = [(one["what"], one["who"]) for one in made.access.audit.read_last(20)]
    assert written.count(("set_zero", "the-engineer")) == 1
    made.plant.zero_refusal = Message("zero: only 40% of the belt is bare", "zero_set_not_bare", share=40)
    refused = engineer("POST", "/api/zero/measure")
    assert refused.status_code == 409
    assert (refused.json()["cause"], refused.json()["values"]) == ("zero_set_not_bare", {"share": 40})
    made.history.close()
