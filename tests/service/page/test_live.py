"""The operator's page in a real browser, without a network: current values and their age."""

from __future__ import annotations

import pytest

from tests.service.page.site import (
    Site,
    needs_chromium,
    read_text,
    wait_for,
    wait_for_change,
    wait_until_live,
)

pytestmark = needs_chromium


FLOW = """(() => {
  const read = (id) => document.querySelector(id).innerText;
  const volume = parseFloat(read('#flow-volume').replace(',', ''));
  return 300 < volume && volume < 900 && read('#flow-sigma').startsWith('±')
    && read('#flow-capacity') === '4.20\u00a0m/s';
})()"""
"""Whether the page shows the plant's flow with its σ and the belt speed that the computer holds."""


def test_page_loads_offline_without_errors_and_updates(site):
    page = site.page(webgl=True)
    wait_until_live(page)
    wait_for(page, FLOW)  # all of it at one moment: on a busy machine there may be no flow for a while
    wait_for_change(page, "#total-belt", read_text(page, "#total-belt"))
    assert page.locator("#cameras img:not([hidden])").count() == 0  # nobody can see them yet
    page.locator("section.cameras").evaluate("section => section.scrollIntoView()")  # however the page moves
    wait_for(page, "document.querySelectorAll('#cameras img:not([hidden])').length === 5")
    assert page.locator("#section svg .outline").count() >= 1
    assert page.locator("#chart canvas").count() == 1
    wait_for(page, "document.querySelector('#belt-none').hidden")
    assert not page.locator("#belt-flat").is_visible()
    wait_for(page, "document.querySelector('#flow-standing').innerText === 'valid'")
    assert (site.errors, site.foreign_requests) == ([], [])
    page.context.close()


@pytest.mark.thorough
def test_a_flow_without_a_measured_record_is_not_shown_though_frames_arrive(site, page):
    wait_for(page, "document.querySelector('#flow-volume').innerText.length > 1")
    measure, site.works.plant._measure = site.works.plant._measure, lambda _: None
    try:
        page.wait_for_selector("body[data-link=stale]")
        assert read_text(page, "#flow-volume") == "–"
        assert read_text(page, "#flow-standing") != "valid"
        assert "No measured record" in read_text(page, "#banner")
    finally:
        site.works.plant._measure = measure
    wait_until_live(page)
    assert site.errors == []


def test_stale_values_are_marked_and_the_page_reconnects(site, page):
    wait_for(page, "document.querySelector('#flow-volume').innerText.length > 1")
    site.running.paused.set()
    page.wait_for_selector("body[data-link=stale]")
    assert read_text(page, "#flow-volume") == "–"
    assert read_text(page, "#flow-last").startswith("Last: ")
    assert "not current" in read_text(page, "#banner")
    site.running.paused.clear()
    wait_until_live(page)
    site.stop()
    page.wait_for_selector("body[data-link=lost]")
    assert read_text(page, "#flow-volume") == "–"
    assert "Connection lost" in read_text(page, "#banner")
    site.restart()
    wait_until_live(page)
    page.wait_for_selector("#banner", state="hidden")
    wait_for(page, "document.querySelector('#flow-volume').innerText.length > 1")
    site.errors.clear()  # the browser itself logs that nobody answered


@pytest.mark.thorough
def test_page_before_the_first_frame_states_this_and_shows_alarms(tmp_path, browser):
    made = Site(tmp_path, browser, frames=0)
    made.running.close()
    page = made.page()
    page.wait_for_selector("body[data-link=stale]")
    assert "not received a frame" in read_text(page, "#banner")
    assert read_text(page, "#flow-volume") == "–"
    assert read_text(page, "#alarms-none") == "No alarms"
    assert made.errors == []
    page.context.close()
    made.close()
