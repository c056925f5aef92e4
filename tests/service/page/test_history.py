"""The page's history: periods, sections and events."""

from __future__ import annotations

from tests.service.page.site import needs_chromium, read_text, wait_for

pytestmark = needs_chromium


def test_views_that_are_not_for_operators_or_without_products_are_not_shown(page):
    for view in ("health", "production"):
        page.evaluate(f"location.hash = '#{view}'")
        page.wait_for_selector("#live-view:visible")
        assert page.locator(f"#to-{view}").is_hidden()
        assert page.locator(f"#{view}-view").is_hidden()


def test_history_shows_a_period_and_its_section(site, page):
    page.evaluate("location.hash = '#history'")
    page.wait_for_selector("#history-days td")
    page.click("[data-preset=h1]")
    wait_for(page, "new URL(document.querySelector('#export-csv').href).searchParams.has('until_ms')")
    assert page.locator("#history-sums dd").count() == 5
    box = page.locator("#history-chart .u-over").bounding_box()
    page.mouse.click(box["x"] + box["width"] - 3, box["y"] + 40)
    page.wait_for_selector("#history-section svg .outline")
    page.fill("#history-to", "2001-01-01T00:00:00")
    page.click("form .plain:not([download])")
    assert "must be after" in read_text(page, "#history-problem")
    assert site.errors == []


def test_events_are_in_the_pages_language(site, page):
    history = site.works.history
    history.add_event(
        "alarm", "camera_lost:cam3", "raised: no image for 4 s; check its power",
        parameters={"state": "raised", "cause": "silent", "values": {"seconds": 4}},
    )  # fmt: skip
    history.add_event(
        "alarm", "oversize_lump", "raised: a lump of 230 mm",
        parameters={"state": "raised", "value": 230.0, "limit": 200.0, "unit": "mm"},
    )  # fmt: skip
    history.add_event("alarm", "slip", "gone: encoder and material differ by 5 %")  # of an older version
    history.add_event("worker", "replaced", "frame 7: the worker that ran it was killed")
    history.add_event("maintenance", "begin", "x", parameters={"reason": "Reinigung", "minutes": 30.0})
    page.select_option("#language", "de")
    page.evaluate("location.hash = '#live'")
    page.evaluate("location.hash = '#history'")
    wait_for(page, "document.querySelectorAll('#history-events tbody tr').length >= 5")
    text = read_text(page, "#history-events")
    assert "Kamera verloren: cam3 – anstehend: Seit 4 s kein Bild" in text
    assert "Überkorn – anstehend: 230\u00a0mm, Grenze 200\u00a0mm" in text
    assert "Wartung beginnt: Reinigung, höchstens 30 min" in text
    assert "Ein Prozess, der Bildsätze auswertet, endete" in text
    assert not [word for word in ("check", "differ", "killed") if word in text]
