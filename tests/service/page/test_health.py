"""The page's checks and the setting of zero, for engineers."""

from __future__ import annotations

import time
from math import nan

import pytest

from beltscape.core.findings import Finding
from beltscape.core.translatable_message import Message
from beltscape.sinks.historian import StoredFinding
from tests.service.findings import DIRT
from tests.service.page.site import needs_chromium, read_text, wait_for
from tests.thorough import list_rows

pytestmark = needs_chromium


FINDINGS = (
    DIRT,
    Finding("zero_shift", 0.3, 0.1, 2.0, "mm"),
    Finding("encoder_motion", nan, nan, 0.02, ""),
)


@pytest.mark.parametrize(
    ("language", "wide"), list_rows([("en", 1300), ("de", 360), ("zh", 1300)], [("de", 360)])
)
def test_engineers_see_the_checks_with_trends_and_pictures(site, language, wide):
    works, now = site.works, time.time_ns()
    works.plant.send_findings(FINDINGS)
    works.history.add_findings(
        [StoredFinding(now - k * 10_000_000_000, each) for k in range(60) for each in FINDINGS]
    )
    page = site.page(f"/?lang={language}#health", wide=wide, high=740, user="eva")
    page.wait_for_selector("#checks .check")
    assert page.locator("#checks .check").count() == 3
    first = page.locator("#checks .check").first
    assert first.get_attribute("data-state") == "degraded" and "cam2" in first.inner_text()
    page.wait_for_selector("#checks .check[data-key='zero_shift:'] .trend-plot .outline", state="attached")
    page.wait_for_selector("#checks .check[data-key='dirt:cam2'] .trend-plot .fault", state="attached")
    wait_for(page, "document.querySelectorAll('#health-pictures rect').length === 1")
    assert page.evaluate("document.documentElement.scrollWidth") == wide
    page.emulate_media(media="print")
    assert not page.locator(".bar").is_visible() and first.is_visible()
    assert site.errors == []
    page.context.close()


@pytest.fixture(scope="module")
def page(site):
    opened = site.page("/?lang=de#health", high=740, user="eva")
    yield opened
    opened.context.close()


def test_engineers_set_the_zero_after_seeing_what_was_measured(site, page):
    plant = site.works.plant
    plant.zero_refusal = Message("zero: only 40% of the belt is bare", "zero_set_not_bare", share=40)
    page.click("#zero-open")
    page.click("#zero-next")
    page.wait_for_selector("#zero-dialog .problem:visible")
    assert (
        read_text(page, "#zero-dialog .problem")
        == "Nur 40\u00a0% des Bandes sind frei: Band leeren und reinigen."
    )
    plant.zero_refusal = ""
    page.click("#zero-next")
    wait_for(page, "document.querySelector('#zero-dialog').innerText.includes('0,42 ± 0,05 mm')")
    assert plant.zeros == []
    page.click("#zero-next")
    wait_for(page, "document.querySelector('#zero-dialog').innerText.includes('Nullpunkt ist gesetzt')")
    assert plant.zeros == [(7, "eva")]
    written = [one["what"] for one in site.works.access.audit.read_last(50) if one["who"] == "eva"]
    assert "set_zero" in written
    page.keyboard.press("Escape")
    assert [error for error in site.errors if "409" not in error] == []
    site.errors.clear()


def test_engineers_have_the_images_learned_anew_after_a_confirmation(site, page):
    page.click("#learn-open")
    assert site.works.plant.learned_by == []
    page.click("#learn-next")
    wait_for(
        page,
        "document.querySelector('#learn-dialog').innerText.includes('aus den nächsten guten Bildern gelernt')",
    )
    assert site.works.plant.learned_by == ["eva"]
    assert "learn_images" in [one["what"] for one in site.works.access.audit.read_last(50)]
    assert site.errors == []
    page.keyboard.press("Escape")


def test_engineers_take_over_changed_settings(site, page):
    reloader = site.works.reloader
    page.click("#settings-open")
    wait_for(
        page, "document.querySelector('#settings-found').innerText.includes('density.kg_m3 1500.0 → 1600.0')"
    )
    shown = "document.querySelector('#settings-dialog').innerText"
    wait_for(page, f"{shown}.includes('Braucht einen Neustart')")
    assert reloader.by == []
    page.click("#settings-next")
    wait_for(page, f"{shown}.includes('Gilt jetzt')")
    assert reloader.by == ["eva 127.0.0.1"]
    reloader.fault = "project.toml: density.kg_m3 = -5: must be greater than 0"
    page.click("#settings-dialog button")
    page.click("#settings-open")
    wait_for(page, f"{shown}.includes('Nichts wurde geändert: project.toml: density')")
    assert [error for error in site.errors if "409" not in error] == []
    site.errors.clear()
