"""The settings over HTTP: engineers see and take over what differs; refusals are one line."""

from __future__ import annotations

from pathlib import Path

from tests.service.plants import make_service

CHANGES, RELOAD = "/api/settings/changes", "/api/settings/reload"


def test_engineers_compare_and_take_over(tmp_path: Path) -> None:
    works = make_service(tmp_path)
    browser = works.browser("engineer")
    found = browser("GET", CHANGES).json()
    assert found["at_once"] == [{"key": "density.kg_m3", "before": "1500.0", "after": "1600.0"}]
    assert [one["key"] for one in found["restart"]] == ["web.port"]
    assert works.reloader.by == []
    assert browser("POST", RELOAD).json() == found
    assert works.reloader.by == ["the-engineer 127.0.0.1"]
    assert browser("GET", CHANGES).json()["at_once"] == []
    works.reloader.fault = "project.toml: density.kg_m3 = -5: must be greater than 0"
    for answer in (browser("GET", CHANGES), browser("POST", RELOAD)):
        assert (answer.status_code, answer.json()["detail"]) == (409, works.reloader.fault)
    works.history.close()


def test_others_may_not(tmp_path: Path) -> None:
    works = make_service(tmp_path)
    browser = works.browser("operator")
    assert (browser("GET", CHANGES).status_code, browser("POST", RELOAD).status_code) == (403, 403)
    assert works.reloader.by == []
    works.history.close()
