"""The production view: a product is changed, a batch is started and stopped, and a phone shows it all."""

from __future__ import annotations

from dataclasses import replace

import pytest

from beltscape.core.alarms import Alarm
from beltscape.production.settings import ScaleSettings
from beltscape.service.hosting import serve
from beltscape.service.production.figures import ProductionFigures
from tests.service.page.site import Site, needs_chromium, read_text, wait_for
from tests.service.plants import add_production
from tests.service.production.plants import make_control
from tests.thorough import list_cases

pytestmark = needs_chromium


@pytest.fixture(scope="module")
def production_site(tmp_path_factory, browser):
    made = Site(tmp_path_factory.mktemp("production"), browser)
    made.server.close()
    figures = ProductionFigures(make_control(made.works.history), ScaleSettings())
    add_production(made.works, figures)
    made.server = serve(made.works.app, made.works.settings)
    made.address = made.server.address
    yield made
    made.close()


def test_an_operator_changes_the_product_and_counts_a_batch(production_site):
    page = production_site.page("/#production")
    page.wait_for_selector("#products button[aria-pressed=true]")
    assert read_text(page, "#products [aria-pressed=true] b") == "ore"
    page.click("#products button[aria-pressed=false]")
    page.click("#production-dialog .main")
    wait_for(page, "document.querySelector('#products [aria-pressed=true] b').innerText === 'coal'")
    page.fill("#batch-name", "<b>truck 7</b>")
    page.click("#batch-form button")
    wait_for(page, "document.querySelector('#batch-now .name')?.innerText === '<b>truck 7</b>'")
    wait_for(page, "/[1-9].*±/.test(document.querySelector('#batch-now .sum-line').innerText)")
    page.click("#batch-stop")
    # The table can still show the batch as it began, open and empty, until the stop is answered.
    wait_for(page, "document.querySelector('#batches tbody tr')?.innerText.includes('coal')")
    assert len(page.query_selector_all("#batches tbody tr")) == 1
    page.click("#batches tbody button")
    page.fill("#counter-begin", "1000")
    page.fill("#counter-end", "900000")
    page.click("#production-dialog .main")
    wait_for(page, "document.querySelector('#batches .disagrees') !== null")
    page.evaluate("location.hash = '#live'")
    wait_for(page, "document.querySelector('#flow-product').innerText === 'coal'")
    page.evaluate("location.hash = '#history'")
    wait_for(page, "document.querySelector('#history-events')?.innerText.includes('coal instead of ore')")
    assert production_site.errors == []
    page.context.close()


@pytest.mark.thorough
@pytest.mark.parametrize("language", list_cases(["de", "zh"], ["de"]))
def test_the_view_fits_a_phone(production_site, language):
    page = production_site.page(
        f"/?lang={language}#production", wide=360, high=740, has_touch=True, user="eva"
    )
    page.wait_for_selector("#periods td b")
    page.wait_for_selector("#to-health:visible")  # an engineer has all five views
    assert page.evaluate("document.documentElement.scrollWidth") == 360
    assert production_site.errors == []
    page.context.close()


def test_a_wall_display_cuts_no_fact_off_beside_product_and_alarm(production_site):
    plant = production_site.works.plant
    overload = Alarm("overload", "critical", "raised", 107.0, 100.0, "%", 1)
    plant.raise_alarm(overload)
    page = production_site.page("/?wall", wide=1920, high=1080)
    page.wait_for_selector("#now:visible")
    wait_for(page, "document.querySelector('#flow-product').innerText !== ''")
    for name in ("flow", "totals"):
        card = page.locator(f"section.{name}").first
        assert card.evaluate("card => card.scrollHeight <= card.clientHeight"), name
    plant.raise_alarm(replace(overload, state="clear"))
    assert production_site.errors == []
    page.context.close()
