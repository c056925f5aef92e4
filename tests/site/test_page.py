"""The site's page in a browser: belts, one of them away, transfer points and totals, on a phone and a desk."""

from __future__ import annotations

from pathlib import Path

import pytest

from beltscape.service.access import Access, AccessSettings
from beltscape.service.access.accounts import User
from beltscape.service.hosting import serve
from beltscape.service.settings import list_languages, read_texts
from beltscape.site.run import serve_site
from beltscape.site.settings import read_site
from tests.protocols.broker import find_port
from tests.service.access.sample_app import CHEAP, PASSWORD
from tests.service.page.site import ARGS, CHROMIUM, needs_chromium
from tests.service.plants import make_service

LINES = """
[web]
port = 0
plant = "Quarry"
[[balances]]
name = "Tower 2"
inflow = ["north"]
outflow = ["south"]
"""


@pytest.mark.browser
@needs_chromium
def test_the_page_shows_belts_transfer_points_and_totals(tmp_path: Path) -> None:
    # it starts a browser, once for both sizes
    from playwright.sync_api import sync_playwright

    works = make_service(tmp_path / "north")
    server = serve(works.app, works.settings)
    for _ in range(20):
        works.plant.step()
    urls = {"north": server.address, "south": f"http://127.0.0.1:{find_port()}"}
    belts = "".join(f'[[belts]]\nname = "{n}"\nurl = "{url}"\nkey_file = "key"\n' for n, url in urls.items())
    (tmp_path / "key").write_text(works.access.keys.create("site"))
    (tmp_path / "site.toml").write_text(LINES + belts)
    site = read_site(tmp_path / "site.toml")
    site.data.mkdir()
    access = Access(site.data, AccessSettings(), CHEAP)
    access.accounts.add("anna", "viewer", PASSWORD)
    token = access.sessions.open(User("anna", "viewer"), "")
    access.close()
    errors: list[str] = []
    with serve_site(site) as running, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=ARGS)
        for i, language in enumerate(list_languages()[:2]):  # that all texts are there is tested beside them
            wide = 1300 if i else 380  # the first one on a phone
            context = browser.new_context(viewport={"width": wide, "height": 800})
            context.add_cookies([{"name": "beltscape", "value": token, "url": running.server.address}])
            page = context.new_page()
            page.on("pageerror", lambda error: errors.append(str(error)))
            page.on("console", lambda one: errors.append(one.text) if one.type == "error" else None)
            page.goto(f"{running.server.address}/?lang={language.code}")
            page.wait_for_selector('.card[data-state="away"]')
            texts = read_texts(language.code)
            shown = page.inner_text("main")
            assert "north" in shown
            assert texts["site.away"] in shown
            assert "Tower 2" in shown
            assert texts["site.balance_none"] in shown
            assert urls["south"] in page.inner_text("#belts")
            assert "site." not in shown, "a text is missing"
            assert page.evaluate("document.documentElement.scrollWidth") <= wide
            page.click('#kinds [data-kind="shift"]')
            page.wait_for_selector("#totals tbody tr:nth-child(3)")
            context.close()
        browser.close()
    server.close()
    works.history.close()
    works.access.close()
    assert errors == []
