"""What an operator does on the page: alarms, recordings, language, theme, maintenance."""

from __future__ import annotations

import re
from dataclasses import replace

from beltscape.core.alarms import Alarm
from tests.service.page.site import needs_chromium, read_text, wait_for, wait_for_change

pytestmark = needs_chromium


def test_an_alarm_is_announced_and_acknowledged_by_keyboard(site, page):
    assert page.locator("#alarms-none").is_visible()
    site.works.plant.raise_alarm(Alarm("overload", "critical", "raised", 107.0, 100.0, "%", 1))
    page.wait_for_selector(".alarm[data-state=raised]")
    text = read_text(page, ".alarm")
    assert "Overload" in text and "critical" in text and "107" in text
    assert page.locator("#alarms-said").inner_text() == "Alarm: Overload"
    page.keyboard.press("a")
    page.keyboard.press("Enter")
    page.wait_for_selector(".alarm[data-state=acknowledged]")
    assert "acknowledged by ana" in read_text(page, ".alarm")
    assert site.works.plant.alarms["overload"].by == "ana"
    site.works.plant.raise_alarm(replace(site.works.plant.alarms["overload"], state="clear"))
    page.wait_for_selector("#alarms-none:visible")
    assert site.errors == []


def test_a_recording_is_kept_by_keyboard_with_a_reason(site, page):
    page.keyboard.press("k")
    page.keyboard.type("a big lump")
    page.keyboard.press("Enter")
    page.wait_for_selector("#keep-dialog", state="hidden")
    assert read_text(page, "#keep") == "Kept"
    assert site.works.plant.kept == [("a big lump", "ana")]
    assert site.errors == []


def test_maintenance_begins_is_displayed_and_ends(site, page):
    page.click("#maintenance-begin")
    page.fill("#maintenance-reason", "cleaning the windows")
    page.select_option("#maintenance-minutes", "15")
    page.click("#maintenance-dialog .main")
    page.wait_for_selector("#maintenance:visible")
    assert "cleaning the windows (ana" in read_text(page, "#maintenance-text")
    wait_for(page, "document.querySelector('#flow-volume').innerText === '–'")
    assert read_text(page, "#flow-standing") == "Maintenance"
    assert site.works.plant.maintenance is not None
    (entry,) = [one for one in site.works.access.audit.read_last(50) if one["what"] == "begin_maintenance"]
    assert entry["who"] == "ana"
    page.click("#maintenance-end")
    page.wait_for_selector("#maintenance", state="hidden")
    wait_for(page, "document.querySelector('#flow-volume').innerText.length > 1")
    assert site.works.plant.maintenance is None and site.errors == []


def test_language_and_theme_change_by_keyboard(site, page):
    english = read_text(page, "#flow-title")
    page.keyboard.press("g")
    wait_for_change(page, "#flow-title", english)
    assert page.get_attribute("html", "lang") == "de"
    assert re.search(r"\d,\d", read_text(page, "#flow-speed"))
    page.keyboard.press("g")
    page.wait_for_selector("html[lang=es]")
    assert read_text(page, "#flow-title") == "Caudal actual"
    page.keyboard.press("g")
    page.wait_for_selector("html[lang=zh-Hans]")
    assert re.search(r"[\u4e00-\u9fff]", read_text(page, "#flow-title"))
    page.keyboard.press("t")
    page.wait_for_selector("html[data-theme=dark]")
    page.reload()
    page.wait_for_selector("html[data-theme=dark][lang=zh-Hans]")
    page.keyboard.press("?")
    assert page.locator("#keys kbd").count() == 12
    assert site.errors == []
