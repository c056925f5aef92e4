"""The pages below a path of a plant's portal: page, files, interface, sign-in, cookies and redirects."""

from __future__ import annotations

import re
from contextlib import ExitStack, closing
from pathlib import Path

import httpx
import pytest

from beltscape.service.hosting import serve
from beltscape.service.settings import LimitSettings
from beltscape.site.settings import SiteBeltSettings
from tests.docs.blocks import read_blocks
from tests.docs.conftest import page_text
from tests.service.access.sample_app import PASSWORD
from tests.service.page.site import NO_WEBGL, SOON_MS, needs_chromium
from tests.service.plants import make_service
from tests.service.proxy import Location, Proxy, read_locations
from tests.thorough import list_cases

PAGE = "docs/howto/access.md"
TRUSTED = LimitSettings(trusted_proxies=("127.0.0.1",))


def read_manual() -> Location:
    """Return the location of the manual's block."""
    (block,) = [one for one in read_blocks(PAGE, page_text(PAGE)) if one.kind == "nginx"]
    (location,) = read_locations(block.text)
    return location


@pytest.fixture(scope="module")
def portal(tmp_path_factory: pytest.TempPathFactory):
    """Two belts behind one portal by the manual's block, a third by nothing but its path."""
    tmp_path = tmp_path_factory.mktemp("portal")
    manual, locations, parts = read_manual(), [], []
    with ExitStack() as stack:
        for number in (4, 5, 6):
            made = make_service(tmp_path / str(number), 3, plant=f"Belt {number}", limits=TRUSTED)
            stack.callback(made.history.close)
            stack.callback(made.access.close)
            made.access.accounts.add("ana", "operator", PASSWORD)
            server = stack.enter_context(closing(serve(made.app, made.settings)))
            headers = {k: v.replace("/belt4", f"/belt{number}") for k, v in manual.headers.items()}
            if number == 6:
                headers = {k: v for k, v in headers.items() if not k.startswith("x-")}
            locations.append(Location(f"/belt{number}/", f"{server.address}/", headers))
            parts.append(made)
        proxy = stack.enter_context(closing(Proxy(locations)))
        yield proxy.address, parts


def test_nothing_in_a_page_is_asked_for_outside_of_its_path(portal):
    address, _ = portal
    with httpx.Client(base_url=f"{address}/belt6/") as client:
        login = client.get("", headers={"accept": "text/html"})
        assert (login.status_code, login.headers["location"]) == (303, "login")
        assert (
            client.get("api/export", headers={"accept": "text/html"})
            .headers["location"]
            .startswith("../login?")
        )
        asked = set()
        for page in ("login", "setup", "page/index.html"):
            asked |= set(re.findall(r'(?:src|href)="([^"#]+)"', client.get(page).text))
        assert {"page/style/tokens.css", "access/login.js", "page/script/main.js"} <= asked
        for path in asked - {"./"}:
            assert not path.startswith("/"), path
            assert client.get(path, headers={"accept": "text/html"}).status_code in (200, 303), path


def test_belts_behind_one_portal_have_cookies_of_their_own(portal):
    address, _ = portal
    login = {"name": "ana", "password": PASSWORD}
    with httpx.Client() as client:
        for number in (4, 5):
            headers = {"Origin": address, "Sec-Fetch-Site": "same-origin"}
            reply = client.post(f"{address}/belt{number}/api/access/login", json=login, headers=headers)
            assert reply.status_code == 200
            assert f"beltscape-belt{number}=" in reply.headers["set-cookie"]
            assert f"; Path=/belt{number}/;" in reply.headers["set-cookie"]
        for number in (4, 5):
            assert client.get(f"{address}/belt{number}/api/page").json()["plant"] == f"Belt {number}"
        foreign = {"Origin": "http://portal.example", "Sec-Fetch-Site": "same-site"}
        reply = client.post(f"{address}/belt4/api/access/logout", headers=foreign)
        assert reply.status_code == 403


def test_a_path_from_a_stranger_or_of_a_strange_form_is_not_taken(portal, tmp_path: Path):
    _, parts = portal
    login = {"name": "ana", "password": PASSWORD}
    for trusted, prefix in ((TRUSTED, "/a b;x"), (TRUSTED, "//evil"), (LimitSettings(), "/belt4")):
        settings = parts[0].settings.model_copy(update={"limits": trusted})
        with closing(serve(parts[0].app, settings)) as server:
            headers = {"X-Forwarded-Prefix": prefix}
            reply = httpx.post(f"{server.address}/api/access/login", json=login, headers=headers)
            assert reply.headers["set-cookie"].startswith("beltscape=")
            assert "; Path=/;" in reply.headers["set-cookie"]


def test_a_cookie_of_a_path_belongs_to_tls(portal):
    _, parts = portal
    headers = {"X-Forwarded-Prefix": "/belts/4/", "X-Forwarded-Proto": "https"}
    with closing(serve(parts[0].app, parts[0].settings)) as server:
        login = {"name": "ana", "password": PASSWORD}
        reply = httpx.post(f"{server.address}/api/access/login", json=login, headers=headers)
    assert reply.headers["set-cookie"].startswith("__Secure-beltscape-belts-4=")
    assert "; Path=/belts/4/;" in reply.headers["set-cookie"]


def test_a_site_follows_a_belt_below_a_path(portal, tmp_path: Path):
    from beltscape.site.client import BeltClient

    address, parts = portal
    (tmp_path / "key").write_text(parts[0].access.keys.create("site"))
    settings = SiteBeltSettings(name="4", url=f"{address}/belt4/", key_file=tmp_path / "key")
    with closing(BeltClient(settings)) as client:
        assert client.read_state().frames is not None


@needs_chromium
@pytest.mark.parametrize("number", list_cases([4, 6], [4]))
def test_the_page_lives_below_a_path(portal, browser, number):
    address, _ = portal
    assert walk_through(browser, f"{address}/belt{number}/", f"Belt {number}") == []


def walk_through(browser, root: str, plant: str) -> list[str]:
    """Sign in, open the page and the account, sign out; return errors and what was asked for outside of ``root``."""
    wrong: list[str] = []
    with closing(browser.new_context(locale="en-GB")) as context:
        context.set_default_timeout(SOON_MS)
        context.add_init_script(NO_WEBGL)
        page = context.new_page()
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on(
            "request",
            lambda one: None if one.url.startswith((root, "data:", "blob:")) else wrong.append(one.url),
        )
        page.goto(root)
        page.wait_for_url(f"{root}login")
        page.fill("[name=name]", "ana")
        page.fill("[name=password]", PASSWORD)
        page.click("button.primary")
        page.wait_for_url(root)
        page.wait_for_selector("body:not([data-link=waiting])")  # the live channel has sent a state
        assert page.inner_text("#plant") == plant
        page.click("#who a")
        page.wait_for_selector("#you:has-text('ana')")
        page.click("nav a")
        page.wait_for_url(root)
        page.click("#who button")
        page.wait_for_url(f"{root}login")
    return wrong
