"""The page's panel of the rig's drift, for engineers."""

from __future__ import annotations

import json

import pytest

from beltscape.service.settings import read_texts
from tests.service.fake_drift import FakeDrift
from tests.service.page.site import needs_chromium, read_text, wait_for
from tests.thorough import list_rows

pytestmark = needs_chromium

REFUSAL = "project.toml: density.kg_m3 = -1: must be at least 0; the rig stays as it was"
PHONE = 390


@pytest.fixture
def drift(site):
    fake = FakeDrift()
    site.stop()
    site.restart(drift=fake)
    return fake


def open_panel(site, query: str, wide: int = PHONE):
    """Return the page with the open dialog."""
    page = site.page(f"/?{query}#health", wide=wide, high=840, user="eva")
    page.click("#drift-open")
    page.wait_for_selector("#drift-dialog[open]")
    return page


def wait_for_text(page, text: str) -> None:
    wait_for(page, f"document.querySelector('#drift-dialog').innerText.includes({json.dumps(text)})")


@pytest.mark.parametrize(
    ("language", "theme", "wide"),
    list_rows(
        [("zh", "dark", PHONE), ("en", "light", 1300), ("de", "light", PHONE), ("es", "dark", PHONE)],
        [("zh", "dark", PHONE)],
    ),
)
def test_an_engineer_takes_the_proposal_and_undoes_it(site, drift, language, theme, wide) -> None:
    texts = read_texts(language)
    page = open_panel(site, f"theme={theme}&lang={language}", wide)
    wait_for_text(page, "cam2")
    assert drift.calls == []
    assert not page.locator("#drift-undo").is_visible()
    box = page.locator("#drift-dialog").bounding_box()
    assert box is not None and box["x"] >= 0 and box["x"] + box["width"] <= wide
    assert page.evaluate("document.documentElement.scrollWidth") == wide
    page.click("#drift-take")
    wait_for_text(page, texts["drift.taken"])
    wait_for_text(page, texts["drift.also"].format(settings="empty, density.table"))
    assert not page.locator("#drift-take").is_visible()
    drift.change_fault = REFUSAL
    page.click("#drift-undo")
    page.wait_for_selector("#drift-dialog .problem:visible")
    assert read_text(page, "#drift-dialog .problem") == f"{texts['drift.refused']} {REFUSAL}"
    assert page.locator("#drift-undo").is_enabled()  # what was taken is still there to be undone
    drift.change_fault = ""
    page.click("#drift-undo")
    wait_for_text(page, texts["drift.undone"])
    assert not page.locator("#drift-dialog .problem").is_visible()
    assert [each[0] for each in drift.calls] == ["take", "undo"]
    assert [error for error in site.errors if "409" not in error] == []
    site.errors.clear()
    page.context.close()


def test_the_time_to_the_first_estimate_is_that_of_the_settings(site, drift) -> None:
    drift.newest_is_there = False
    texts = read_texts("en")
    for window_s, said in ((300.0, "5\u00a0min"), (9000.0, "2.5\u00a0h")):
        drift.window_s = window_s
        page = open_panel(site, "lang=en", 1300)
        wait_for_text(page, texts["drift.reference_only"].format(time=said))
        page.context.close()
    drift.window_s = 0.0
    page = open_panel(site, "lang=en", 1300)
    wait_for_text(page, texts["drift.off"])
    page.context.close()


def test_a_week_without_load_has_no_litres(site, drift) -> None:
    drift.volume_l = None
    page = open_panel(site, "lang=en")
    wait_for_text(page, "cam2")
    text = read_text(page, "#drift-found")
    assert "NaN" not in text and "null" not in text and "0 ± 0 l" not in text
    page.context.close()
