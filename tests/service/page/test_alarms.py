"""The alarms on the page: shelving, out of service, reset, first-out, journal, key figures, own texts."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest

from beltscape.core.alarms import Alarm
from tests.service.page.site import Site, needs_chromium, read_text, wait_for, wait_until_live

pytestmark = needs_chromium
NAN = float("nan")
LOST = Alarm(
    "camera_lost:cam2",
    "warning",
    "raised",
    NAN,
    NAN,
    "",
    1,
    "silent",
    priority="high",
    group="images",
    is_first=True,
)


@pytest.fixture(scope="module")
def site(tmp_path_factory, browser):
    """A plant with an own text, an alarm and a journal."""
    made = Site(tmp_path_factory.mktemp("site"), browser)
    own = {"title": "Kamera {subject} an Band 4", "detail": "{detail} Werkstatt: 4711"}
    made.works.plant.alarm_controls.texts = {"de": {"camera_lost": own}}
    raised = {"state": "raised", "priority": "high", "first": True}
    for i in range(12):
        made.works.history.add_event(
            "alarm", LOST.name, "raised: silent", wall_ns=time.time_ns() - i * 10**10, parameters=raised
        )
    made.works.plant.raise_alarm(LOST)
    made.works.plant.raise_alarm(
        replace(LOST, name="low_coverage", priority="low", state="acknowledged", is_first=False)
    )
    yield made
    made.close()


def test_an_alarm_is_shelved_shown_as_such_and_shown_again(site, page):
    text = read_text(page, ".alarm[data-key='camera_lost:cam2']")
    assert "Priority: high" in text and "came first" in text
    assert page.locator(".alarm:has-text('cam2') button:has-text('Out of service')").is_hidden()
    page.click(".alarm:has-text('cam2') button:has-text('Shelve')")
    page.fill("#alarm-reason", "cable is coming")
    page.select_option("#alarm-minutes", "60")
    page.click("#alarm-dialog .main")
    page.wait_for_selector("#alarms-hidden:visible")
    assert page.locator(".alarm").count() == 1
    page.click("#alarms-hidden summary")
    hidden = read_text(page, "#alarms-hidden-list")
    assert "cable is coming" in hidden and "by ana" in hidden and "holds now" in hidden
    page.click("#alarms-hidden-list button")
    page.wait_for_selector(".alarm[data-state=raised]")
    assert page.locator("#alarms-hidden").is_hidden() and site.errors == []


def test_an_engineer_takes_out_of_service_and_an_operator_cannot_return_it(site, page):
    engineer = site.page(user="eva")
    wait_until_live(engineer)
    engineer.click(".alarm:has-text('cam2') button:has-text('Out of service')")
    engineer.fill("#alarm-reason", "sent for repair")
    engineer.click("#alarm-dialog .main")
    page.wait_for_selector("#alarms-hidden:visible")
    page.evaluate("document.querySelector('#alarms-hidden').open = true")
    wait_for(page, "document.querySelector('#alarms-hidden-list').innerText.includes('sent for repair')")
    assert page.locator("#alarms-hidden-list button").is_hidden()
    engineer.click("#alarms-hidden summary")
    engineer.click("#alarms-hidden-list button")
    engineer.wait_for_selector(".alarm[data-state=raised]")
    assert site.errors == []
    engineer.context.close()


def test_a_latched_alarm_is_reset(site, page):
    latched = replace(LOST, name="overload", state="latched", needs_reset=True, by="ana", is_first=False)
    site.works.plant.raise_alarm(latched)
    page.click(".alarm[data-key=overload] button:has-text('Reset')")
    page.wait_for_selector(".alarm[data-key=overload]", state="detached")
    assert site.errors == []


def test_the_view_has_key_figures_journal_and_all_alarms(site, page):
    page.evaluate("location.hash = '#alarms-view'")
    wait_for(page, "document.querySelectorAll('#journal tbody tr').length >= 12")
    assert "12 alarms in the last 10 min" in read_text(page, "#flood")
    figures = read_text(page, "#figures")
    assert "Camera lost: cam2" in figures and "high 12" in figures
    assert "12 (100%)" in read_text(page, "#top")
    assert "Camera lost: cam2 – raised, came first: silent" in read_text(page, "#journal")
    row = page.locator("#every-alarm tr:has-text('cam2')")
    assert "high" in row.inner_text() and "images" in row.inner_text()
    assert "measured values lost" in (row.locator("td").nth(1).get_attribute("title") or "")
    answer = page.request.get(f"{site.address}/{page.get_attribute('#journal-csv', 'href')}")
    assert answer.status == 200 and answer.text().startswith("number,time_utc,alarm")
    assert site.errors == []


@pytest.mark.thorough
def test_the_plant_s_own_texts_stand_before_the_page_s(site):
    page = site.page("/?lang=de")
    wait_until_live(page)
    text = read_text(page, ".alarm[data-key='camera_lost:cam2']")
    assert "Kamera cam2 an Band 4" in text and "Stromversorgung" in text and "Werkstatt: 4711" in text
    assert site.errors == []
    page.context.close()
