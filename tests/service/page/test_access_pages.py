"""The access pages in a real browser: setup, login and user management without browser errors."""

from __future__ import annotations

import re
from contextlib import closing
from pathlib import Path

import pytest
from fastapi import FastAPI

from beltscape.service import access as access_package
from beltscape.service.access import Access, install_access
from beltscape.service.hosting import serve
from beltscape.service.settings import list_languages, read_texts
from beltscape.service.static import make_static_files
from tests.service.access.sample_app import CHEAP, PASSWORD
from tests.service.page.site import needs_chromium
from tests.service.running import Web


@pytest.fixture
def service(tmp_path):
    """A service without users, and its address."""
    app = FastAPI()
    app.mount("/page", make_static_files())
    app.add_api_route("/", lambda: {"the": "belt"})
    with closing(Access(tmp_path, None, CHEAP)) as access:
        install_access(app, access)
        with closing(serve(app, Web())) as running:
            yield access, running.address


@pytest.fixture
def page(browser):
    """A page that collects the browser's errors."""
    page = browser.new_page(locale="de-DE")
    page.set_default_timeout(20_000)
    complaints: list[str] = []
    page.on("console", lambda m: complaints.append(m.text) if "status of 4" not in m.text else None)
    page.on("pageerror", lambda e: complaints.append(str(e)))
    yield page
    page.close()
    assert [c for c in complaints if "[DOM]" not in c] == []


def sign_in(page, name: str, password: str) -> None:
    page.fill("[name=name]", name)
    page.fill("[name=password]", password)
    page.click("button.primary")


@needs_chromium
def test_setup_login_and_user_management_in_the_browser(service, page):
    access, address = service
    page.goto(address)
    page.wait_for_selector("h1:has-text('Erster Start')")
    assert page.url == f"{address}/setup"
    page.fill("[name=token]", "0000")
    page.fill("[name=again]", PASSWORD)
    sign_in(page, "Anna", PASSWORD)
    page.wait_for_selector(".problem:has-text('Einrichtungscode')")
    page.fill("[name=token]", access.setup_token)
    page.keyboard.press("Enter")
    page.wait_for_url(f"{address}/")

    page.goto(f"{address}/account")
    page.wait_for_selector("#users tr:has-text('anna')")
    for name, value in (("name", "<b>bert</b>"), ("password", "ore on the belt")):
        page.fill(f"#add [name={name}]", value)
    page.click("#add .primary")
    page.wait_for_selector("#add .problem:has-text('a name has')")
    page.fill("#add [name=name]", "bert")
    page.click("#add .primary")
    page.wait_for_selector("#users tr:has-text('bert')")
    page.wait_for_selector("#log tr:has-text('Benutzer angelegt')")
    page.select_option("#users tr:has-text('anna') select", "viewer")
    page.wait_for_selector("#users-problem:has-text('last engineer')")
    page.click("#leave")
    page.wait_for_url(f"{address}/login")

    page.select_option("#language", "zh")
    page.wait_for_selector("h1:has-text('登录')")
    sign_in(page, "bert", "not this one")
    page.wait_for_selector(".problem:has-text('密码错误')")
    page.goto(f"{address}/login?next=//evil.example/")
    sign_in(page, "bert", "ore on the belt")
    page.wait_for_url(f"{address}/")
    page.goto(f"{address}/account")
    page.wait_for_selector("#you:has-text('bert')")
    assert page.locator("#users-panel").is_hidden()


def test_texts_of_the_access_pages_exist_in_every_language():
    used = set()
    for file in (Path(access_package.__file__).parent / "page").iterdir():
        text = file.read_text(encoding="utf-8")
        used |= set(re.findall(r"""data-(?:text|title|label)="([\w.]+)\"""", text)) | set(
            re.findall(r"""\bt\("([\w.]+)\"""", text)
        )
    assert len(used) > 40
    for language in list_languages():
        assert used - set(read_texts(language.code)) == set(), language
