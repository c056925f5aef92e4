"""Fixtures: one browser for the folder, and a plant with its page for each file."""

from __future__ import annotations

import pytest

from tests.service.page.site import ARGS, CHROMIUM, Site, wait_until_live


@pytest.fixture(scope="package")
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=str(CHROMIUM), args=ARGS)
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def site(tmp_path_factory, browser):
    made = Site(tmp_path_factory.mktemp("site"), browser)
    yield made
    made.close()


@pytest.fixture(scope="module")
def page(site):
    """A page of the plant that the tests of a file use one after the other."""
    opened = site.page()
    wait_until_live(opened)
    yield opened
    opened.context.close()
