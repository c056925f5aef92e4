"""The operator's page in a real browser, without a network."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from math import nan
from pathlib import Path

import pytest

from beltscape.core.live import Alarm
from beltscape.service.access.identity.roles import User
from beltscape.service.app import create_app
from beltscape.service.server import serve
from service.feeder import RunningServer
from service.plants import PASSWORD, works

CHROMIUM = Path("/usr/bin/chromium")
pytestmark = pytest.mark.skipif(
    not CHROMIUM.exists(), reason="no /usr/bin/chromium (Debian's chromium package)"
)
ARGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--mute-audio"]
SOON_MS = 15_000
NO_WEBGL = """const get = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
  return kind.startsWith("webgl") ? null : get.call(this, kind, ...more);
};"""


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=str(CHROMIUM), args=ARGS)
        yield opened
        opened.close()


class Site:
    """A plant that runs, the server in front of it, and pages on it."""

    def __init__(self, folder: Path, browser, *, frames: int = 8) -> None:
        self.browser = browser
        self.works = works(folder, full_m3_h=900.0, stale_s=1.5)
        self.works.access.accounts.add("ana", "operator", PASSWORD)
        self.server = serve(self.works.app, self.works.settings)
        self.address = self.server.address
        for _ in range(frames):
            self.works.plant.step()
        self.running = RunningServer(self.works.plant)
        if not frames:
            self.running.paused.set()
        self.wrong: list[str] = []
        self.elsewhere: list[str] = []

    def page(self, path: str = "/", *, wide: int = 1300, high: int = 800, webgl: bool = False, **more):
        """Somebody's page, signed in; without WebGL, which takes long without a graphics card."""
        context = self.browser.new_context(
            viewport={"width": wide, "height": high}, locale="en-GB", reduced_motion="reduce", **more
        )
        context.set_default_timeout(SOON_MS)
        token = self.works.access.sessions.open(User("ana", "operator"), "")
        context.add_cookies([{"name": "beltscape", "value": token, "url": self.address}])
        if not webgl:
            context.add_init_script(NO_WEBGL)
        page = context.new_page()
        page.on("pageerror", lambda error: self.wrong.append(str(error)))
        page.on("console", lambda said: self.wrong.append(said.text) if said.type == "error" else None)
        page.on(
            "request",
            lambda asked: (
                None
                if asked.url.startswith((self.address, "data:", "blob:"))
                else self.elsewhere.append(asked.url)
            ),
        )
        page.goto(self.address + path)
        return page

    def stop(self) -> None:
        self.server.close()

    def start_again(self) -> None:
        made = self.works
        port = int(self.address.rsplit(":", 1)[1])
        again = made.settings.model_copy(update={"port": port})
        self.server = serve(create_app(made.live_state, made.history, made.access, made.plant, again), again)

    def close(self) -> None:
        self.running.close()
        self.server.close()
        self.works.history.close()


@pytest.fixture(scope="module")
def site(tmp_path_factory, browser):
    made = Site(tmp_path_factory.mktemp("site"), browser)
    yield made
    made.close()


def is_live(page) -> None:
    page.wait_for_selector("body[data-link=live]")


def until(page, wanted: str) -> None:
    """Wait for an expression to be true; the page's own policy forbids the browser to do this by itself."""
    end_s = time.monotonic() + SOON_MS / 1000
    while not page.evaluate(wanted):
        assert time.monotonic() < end_s, wanted
        page.wait_for_timeout(50)


def shown(page, selector: str) -> str:
    return page.inner_text(selector)


def differs(page, selector: str, before: str) -> None:
    until(page, f"document.querySelector({selector!r}).innerText !== {before!r}")


def test_it_loads_without_errors_or_the_outside_world_and_its_numbers_change(site):
    page = site.page(webgl=True)
    is_live(page)
    until(page, "document.querySelector('#flow-volume').innerText > ''")
    assert 300 < float(shown(page, "#flow-volume").replace(",", "")) < 900
    assert shown(page, "#flow-sigma").startswith("±")
    differs(page, "#total-belt", shown(page, "#total-belt"))
    assert page.locator("#cameras img:not([hidden])").count() == 0  # nobody can see them yet
    page.locator("section.cameras").scroll_into_view_if_needed()
    until(page, "document.querySelectorAll('#cameras img:not([hidden])').length === 5")
    assert page.locator("#section svg .outline").count() >= 1
    assert page.locator("#chart canvas").count() == 1
    until(page, "document.querySelector('#belt-none').hidden")
    assert not page.locator("#belt-flat").is_visible()
    assert shown(page, "#flow-standing") == "valid"
    assert (site.wrong, site.elsewhere) == ([], [])
    page.context.close()


def test_an_alarm_is_heard_of_and_acknowledged_by_keys_alone(site):
    page = site.page()
    is_live(page)
    assert page.locator("#alarms-none").is_visible()
    site.works.plant.raise_alarm(Alarm("overload", "critical", "raised", 107.0, 100.0, "%", 1))
    page.wait_for_selector(".alarm[data-state=raised]")
    text = shown(page, ".alarm")
    assert "Overload" in text and "critical" in text and "107" in text
    assert page.locator("#alarms-said").inner_text() == "Alarm: Overload"
    page.keyboard.press("a")
    page.keyboard.press("Enter")
    page.wait_for_selector(".alarm[data-state=acknowledged]")
    assert "acknowledged by ana" in shown(page, ".alarm")
    assert site.works.plant.alarms["overload"].by == "ana"
    site.works.plant.raise_alarm(replace(site.works.plant.alarms["overload"], state="clear"))
    page.wait_for_selector("#alarms-none:visible")
    assert site.wrong == []
    page.context.close()


def test_a_recording_is_kept_by_keys_with_a_reason(site):
    page = site.page()
    is_live(page)
    page.keyboard.press("k")
    page.keyboard.type("a big lump")
    page.keyboard.press("Enter")
    page.wait_for_selector("#keep-dialog", state="hidden")
    assert shown(page, "#keep") == "Kept"
    assert site.works.plant.kept == [("a big lump", "ana")]
    assert site.wrong == []
    page.context.close()


def test_languages_and_themes_by_keys(site):
    page = site.page()
    is_live(page)
    english = shown(page, "#flow-title")
    page.keyboard.press("g")
    differs(page, "#flow-title", english)
    assert page.get_attribute("html", "lang") == "de"
    assert re.search(r"\d,\d", shown(page, "#flow-speed"))
    page.keyboard.press("g")
    page.wait_for_selector("html[lang=zh-Hans]")
    assert re.search(r"[\u4e00-\u9fff]", shown(page, "#flow-title"))
    page.keyboard.press("t")
    page.wait_for_selector("html[data-theme=dark]")
    page.reload()
    page.wait_for_selector("html[data-theme=dark][lang=zh-Hans]")
    page.keyboard.press("?")
    assert page.locator("#keys kbd").count() == 11
    assert site.wrong == []
    page.context.close()


def test_old_numbers_are_never_shown_as_new_and_it_comes_back_by_itself(site):
    page = site.page()
    is_live(page)
    until(page, "document.querySelector('#flow-volume').innerText.length > 1")
    site.running.paused.set()
    page.wait_for_selector("body[data-link=stale]")
    assert shown(page, "#flow-volume") == "–"
    assert shown(page, "#flow-last").startswith("Last: ")
    assert "not current" in shown(page, "#banner")
    site.running.paused.clear()
    is_live(page)
    site.stop()
    page.wait_for_selector("body[data-link=lost]")
    assert shown(page, "#flow-volume") == "–"
    assert "Connection lost" in shown(page, "#banner")
    site.start_again()
    is_live(page)
    page.wait_for_selector("#banner", state="hidden")
    until(page, "document.querySelector('#flow-volume').innerText.length > 1")
    site.wrong.clear()  # the browser itself logs that nobody answered
    page.context.close()


def test_history_shows_a_period_and_its_section(site):
    page = site.page("/?lang=en#history")
    page.wait_for_selector("#history-days td")
    page.click("[data-preset=h1]")
    until(page, "new URL(document.querySelector('#export-csv').href).searchParams.has('until_ms')")
    assert page.locator("#history-sums dd").count() == 5
    box = page.locator("#history-chart .u-over").bounding_box()
    page.mouse.click(box["x"] + box["width"] - 3, box["y"] + 40)
    page.wait_for_selector("#history-section svg .outline")
    page.fill("#history-to", "2001-01-01T00:00:00")
    page.click("form .plain:not([download])")
    assert "must lie after" in shown(page, "#history-problem")
    assert site.wrong == []
    page.context.close()


@pytest.mark.parametrize(("language", "webgl"), [("en", False), ("de", True), ("zh", False)])
def test_a_phone_has_nothing_to_scroll_sideways(site, language, webgl):
    site.works.plant.raise_alarm(
        Alarm("camera_lost:cam3", "warning", "raised", nan, nan, "", 1, "no image: check cable")
    )
    page = site.page(f"/?lang={language}", wide=360, high=740, has_touch=True, webgl=webgl)
    is_live(page)
    page.wait_for_selector(".alarm")
    wide = "document.documentElement.scrollWidth"
    assert page.evaluate(wide) == 360
    page.evaluate("location.hash = '#history'")
    page.wait_for_selector("#history-days td")
    assert page.evaluate(wide) == 360
    assert site.wrong == []
    page.context.close()


def test_the_wall_shows_everything_at_once(site):
    page = site.page("/?wall", wide=1920, high=1080)
    is_live(page)
    page.wait_for_selector("#cameras .camera")
    assert page.evaluate("document.documentElement.scrollHeight") == 1080
    for name in ("flow", "belt", "alarms", "chart", "totals", "section", "cameras"):
        box = page.locator(f"section.{name}").first.bounding_box()
        assert box["y"] + box["height"] <= 1080, name
    assert not page.locator("nav").is_visible()
    assert site.wrong == []
    page.context.close()


def test_a_screen_without_webgl_shows_the_belt_from_above(site):
    page = site.page()
    is_live(page)
    until(page, "document.querySelector('#belt').width > 500")
    pixel = page.evaluate(
        "[...document.querySelector('#belt').getContext('2d').getImageData(590, 50, 1, 1).data]"
    )
    assert pixel[3] == 255 and max(pixel[:3]) - min(pixel[:3]) > 30
    assert page.locator("#belt-flat").is_visible()
    assert site.wrong == []
    page.context.close()


def test_before_the_first_frame_it_says_so_and_knows_its_alarms(tmp_path, browser):
    made = Site(tmp_path, browser, frames=0)
    made.running.close()
    page = made.page()
    page.wait_for_selector("body[data-link=stale]")
    assert "not seen a frame" in shown(page, "#banner")
    assert shown(page, "#flow-volume") == "–"
    assert shown(page, "#alarms-none") == "No alarms"
    assert made.wrong == []
    page.context.close()
    made.close()
