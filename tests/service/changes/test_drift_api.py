"""The drift of the rig over HTTP: engineers read it, take the proposal, undo it; refusals are one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from beltscape.service.app import create_app
from tests.service.fake_drift import FakeDrift
from tests.service.plants import ServiceParts, make_service


@pytest.fixture
def works(tmp_path: Path):
    parts = make_service(tmp_path)
    drift = FakeDrift()
    parts.app = create_app(
        parts.live_state, parts.history, parts.access, parts.plant, parts.settings, drift=drift
    )
    yield parts, drift
    parts.history.close()


def test_engineers_read_take_and_undo(works: tuple[ServiceParts, FakeDrift]) -> None:
    parts, drift = works
    browser = parts.browser("engineer")
    found = browser("GET", "/api/drift").json()
    assert (found["moved"], found["newest"], found["can_undo"]) == ("cam2", 7, False)
    assert (found["change_litres"], found["change_percent"]) == (-50.0, -1.25)
    assert drift.calls == []
    taken = browser("POST", "/api/drift/take", json={"number": 7}).json()
    assert (taken["has_proposal"], taken["estimates"], taken["can_undo"]) == (False, 0, True)
    assert browser("POST", "/api/drift/undo").json()["can_undo"] is False
    assert drift.calls == [("take", 7, "the-engineer", "127.0.0.1"), ("undo", "the-engineer", "127.0.0.1")]
    report = browser("GET", "/api/drift/report?language=de")
    assert "lang=de" in report.text
    assert "sandbox" in report.headers["content-security-policy"]


def test_a_refusal_is_one_line(works: tuple[ServiceParts, FakeDrift]) -> None:
    parts, drift = works
    drift.fault = "estimate 6: the newest is 7; read the drift again and take that one"
    browser = parts.browser("engineer")
    for answer in (browser("GET", "/api/drift"), browser("POST", "/api/drift/take", json={"number": 6})):
        assert (answer.status_code, answer.json()["detail"]) == (409, drift.fault)
    assert browser("GET", "/api/drift/report?language=xx").status_code == 422


def test_others_may_not(works: tuple[ServiceParts, FakeDrift]) -> None:
    parts, drift = works
    browser = parts.browser("operator")
    answers = [
        browser("GET", "/api/drift"),
        browser("GET", "/api/drift/report"),
        browser("POST", "/api/drift/take", json={"number": 7}),
        browser("POST", "/api/drift/undo"),
    ]
    assert [one.status_code for one in answers] == [403] * 4
    assert drift.calls == []
