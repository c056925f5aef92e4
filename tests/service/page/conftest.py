"""Fixtures: one browser for the folder, and a plant with its page for each file."""

from __future__ import annotations

import pytest

from tests.service.page.site import ARGS, CHROMIUM, Site


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
