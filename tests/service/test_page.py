"""The operator's page in a real browser, without a network."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from math import nan
from pathlib import Path

import pytest

from beltscape.core.findings import Finding
from beltscape.core.live import Alarm, CameraHealth
from beltscape.core.translatable_message import Message
from beltscape.service.access.identity.roles import User
from beltscape.service.app import create_app
from beltscape.service.server import serve
from beltscape.sinks.historian import StoredFinding
from tests.service.feeder import PlantThread
from tests.service.plants import PASSWORD, make_service

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
    """A running plant with its server, and browser pages on it."""

    def __init__(self, folder: Path, browser, *, frames: int = 8) -> None:
        self.browser = browser
        self.works = make_service(folder, full_m3_h=900.0, stale_s=1.5)
        self.works.access.accounts.add("ana", "operator", PASSWORD)
        self.works.access.accounts.add("eva", "engineer", PASSWORD)
        self.server = serve(self.works.app, self.works.settings)
        self.address = self.server.address
        for _ in range(frames):
            self.works.plant.step()
        self.running = PlantThread(self.works.plant)
        if not frames:
            self.running.paused.set()
        self.errors: list[str] = []
        self.foreign_requests: list[str] = []

    def page(
        self,
        path: str = "/",
        *,
        wide: int = 1300,
        high: int = 800,
        webgl: bool = False,
        user: str = "ana",
        **more,
    ):
        """Open a page, signed in; without WebGL by default, which is slow without a graphics card."""
        context = self.browser.new_context(
            viewport={"width": wide, "height": high}, locale="en-GB", reduced_motion="reduce", **more
        )
        context.set_default_timeout(SOON_MS)
        token = self.works.access.sessions.open(User(user, "operator"), "")
        context.add_cookies([{"name": "beltscape", "value": token, "url": self.address}])
        if not webgl:
            context.add_init_script(NO_WEBGL)
        page = context.new_page()
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on(
            "console", lambda message: self.errors.append(message.text) if message.type == "error" else None
        )
        page.on(
            "request",
            lambda request: (
                None
                if request.url.startswith((self.address, "data:", "blob:"))
                else self.foreign_requests.append(request.url)
            ),
        )
        page.goto(self.address + path)
        return page

    def stop(self) -> None:
        self.server.close()

    def restart(self) -> None:
        parts = self.works
        port = int(self.address.rsplit(":", 1)[1])
        again = parts.settings.model_copy(update={"port": port})
        self.server = serve(
            create_app(parts.live_state, parts.history, parts.access, parts.plant, again), again
        )

    def close(self) -> None:
        self.running.close()
        self.server.close()
        self.works.history.close()


@pytest.fixture(scope="module")
def site(tmp_path_factory, browser):
    made = Site(tmp_path_factory.mktemp("site"), browser)
    yield made
    made.close()


def wait_until_live(page) -> None:
    page.wait_for_selector("body[data-link=live]")


def wait_for(page, expression: str) -> None:
    """Wait until an expression is true; the content security policy forbids Playwright's own wait."""
    end_s = time.monotonic() + SOON_MS / 1000
    while not page.evaluate(expression):
        assert time.monotonic() < end_s, expression
        page.wait_for_timeout(50)


def read_text(page, selector: str) -> str:
    return page.inner_text(selector)


def wait_for_change(page, selector: str, before: str) -> None:
    wait_for(page, f"document.querySelector({selector!r}).innerText !== {before!r}")


def test_page_loads_offline_without_errors_and_updates(site):
    page = site.page(webgl=True)
    wait_until_live(page)
    wait_for(page, "document.querySelector('#flow-volume').innerText > ''")
    assert 300 < float(read_text(page, "#flow-volume").replace(",", "")) < 900
    assert read_text(page, "#flow-sigma").startswith("±")
    wait_for_change(page, "#total-belt", read_text(page, "#total-belt"))
    assert page.locator("#cameras img:not([hidden])").count() == 0  # nobody can see them yet
    page.locator("section.cameras").scroll_into_view_if_needed()
    wait_for(page, "document.querySelectorAll('#cameras img:not([hidden])').length === 5")
    assert page.locator("#section svg .outline").count() >= 1
    assert page.locator("#chart canvas").count() == 1
    wait_for(page, "document.querySelector('#belt-none').hidden")
    assert not page.locator("#belt-flat").is_visible()
    assert read_text(page, "#flow-standing") == "valid"
    assert (site.errors, site.foreign_requests) == ([], [])
    page.context.close()


def test_an_alarm_is_announced_and_acknowledged_by_keyboard(site):
    page = site.page()
    wait_until_live(page)
    assert page.locator("#alarms-none").is_visible()
    site.works.plant.raise_alarm(Alarm("overload", "critical", "raised", 107.0, 100.0, "%", 1))
    page.wait_for_selector(".alarm[data-state=raised]")
    text = read_text(page, ".alarm")
    assert "Overload" in text and "critical" in text and "107" in text
    assert page.locator("#alarms-said").inner_text() == "Alarm: Overload"
    page.keyboard.press("a")
    page.keyboard.press("Enter")
    page.wait_for_selector(".alarm[data-state=acknowledged]")
    assert "acknowledged by ana" in read_text(page, ".alarm")
    assert site.works.plant.alarms["overload"].by == "ana"
    site.works.plant.raise_alarm(replace(site.works.plant.alarms["overload"], state="clear"))
    page.wait_for_selector("#alarms-none:visible")
    assert site.errors == []
    page.context.close()


def test_a_recording_is_kept_by_keyboard_with_a_reason(site):
    page = site.page()
    wait_until_live(page)
    page.keyboard.press("k")
    page.keyboard.type("a big lump")
    page.keyboard.press("Enter")
    page.wait_for_selector("#keep-dialog", state="hidden")
    assert read_text(page, "#keep") == "Kept"
    assert site.works.plant.kept == [("a big lump", "ana")]
    assert site.errors == []
    page.context.close()


def test_language_and_theme_change_by_keyboard(site):
    page = site.page()
    wait_until_live(page)
    english = read_text(page, "#flow-title")
    page.keyboard.press("g")
    wait_for_change(page, "#flow-title", english)
    assert page.get_attribute("html", "lang") == "de"
    assert re.search(r"\d,\d", read_text(page, "#flow-speed"))
    page.keyboard.press("g")
    page.wait_for_selector("html[lang=zh-Hans]")
    assert re.search(r"[\u4e00-\u9fff]", read_text(page, "#flow-title"))
    page.keyboard.press("t")
    page.wait_for_selector("html[data-theme=dark]")
    page.reload()
    page.wait_for_selector("html[data-theme=dark][lang=zh-Hans]")
    page.keyboard.press("?")
    assert page.locator("#keys kbd").count() == 12
    assert site.errors == []
    page.context.close()


def test_stale_values_are_marked_and_the_page_reconnects(site):
    page = site.page()
    wait_until_live(page)
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
    page.context.close()


def test_history_shows_a_period_and_its_section(site):
    page = site.page("/?lang=en#history")
    page.wait_for_selector("#history-days td")
    page.click("[data-preset=h1]")
    wait_for(page, "new URL(document.querySelector('#export-csv').href).searchParams.has('until_ms')")
    assert page.locator("#history-sums dd").count() == 5
    box = page.locator("#history-chart .u-over").bounding_box()
    page.mouse.click(box["x"] + box["width"] - 3, box["y"] + 40)
    page.wait_for_selector("#history-section svg .outline")
    page.fill("#history-to", "2001-01-01T00:00:00")
    page.click("form .plain:not([download])")
    assert "must be after" in read_text(page, "#history-problem")
    assert site.errors == []
    page.context.close()


@pytest.mark.parametrize(("language", "webgl"), [("en", False), ("de", True), ("zh", False)])
def test_page_fits_a_phone(site, language, webgl):
    site.works.plant.raise_alarm(
        Alarm("camera_lost:cam3", "warning", "raised", nan, nan, "", 1, "no image: check cable")
    )
    page = site.page(f"/?lang={language}", wide=360, high=740, has_touch=True, webgl=webgl)
    wait_until_live(page)
    page.wait_for_selector(".alarm")
    wide = "document.documentElement.scrollWidth"
    assert page.evaluate(wide) == 360
    page.evaluate("location.hash = '#history'")
    page.wait_for_selector("#history-days td")
    assert page.evaluate(wide) == 360
    assert site.errors == []
    page.context.close()


def test_wall_display_shows_everything_at_once(site):
    page = site.page("/?wall", wide=1920, high=1080)
    wait_until_live(page)
    page.wait_for_selector("#cameras .camera")
    assert page.evaluate("document.documentElement.scrollHeight") == 1080
    for name in ("flow", "belt", "alarms", "chart", "totals", "section", "cameras"):
        box = page.locator(f"section.{name}").first.bounding_box()
        assert box["y"] + box["height"] <= 1080, name
    assert not page.locator("nav").is_visible()
    assert site.errors == []
    page.context.close()


def test_without_webgl_the_belt_is_shown_from_above(site):
    page = site.page()
    wait_until_live(page)
    wait_for(page, "document.querySelector('#belt').width > 500")
    pixel = page.evaluate(
        "[...document.querySelector('#belt').getContext('2d').getImageData(590, 50, 1, 1).data]"
    )
    assert pixel[3] == 255 and max(pixel[:3]) - min(pixel[:3]) > 30
    assert page.locator("#belt-flat").is_visible()
    assert site.errors == []
    page.context.close()


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


def test_negative_belt_positions_are_drawn_without_errors(tmp_path, browser):
    made = Site(tmp_path, browser, frames=0)
    made.works.plant.belt_mm = -200_000.0
    made.running.paused.clear()
    for webgl in (False, True):
        page = made.page(webgl=webgl)
        wait_for(page, "document.querySelector('#belt-none').hidden")
        page.wait_for_timeout(600)
        if not webgl:
            wait_for(page, "document.querySelector('#belt').width > 500")
            pixel = page.evaluate(
                "[...document.querySelector('#belt').getContext('2d').getImageData(590, 50, 1, 1).data]"
            )
            assert pixel[3] == 255 and max(pixel[:3]) - min(pixel[:3]) > 30
        page.context.close()
    assert made.works.plant.belt_mm < -1000 and made.errors == []
    made.close()


def test_a_flow_without_a_measured_record_is_not_shown_though_frames_arrive(site):
    page = site.page("/?lang=en")
    wait_until_live(page)
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
    page.context.close()


def test_a_long_camera_message_stretches_no_picture_and_is_translated(site):
    plant = site.works.plant
    message = Message("overexposed: " + "the pixels are saturated; " * 40, "overexposed", share=37)
    camera = CameraHealth("cam3", "unusable", 9, 0, 5.0, 0.1, message)

    def send_health() -> None:
        cameras = {name: replace(camera, name=name, state="ok", message="") for name in ("cam1", "cam2")}
        site.works.live_state.on_health({**cameras, "cam3": camera})

    plant.send_health = send_health
    try:
        page = site.page("/?lang=de")
        page.wait_for_selector(".camera[data-state=unusable]")
        wait_for(page, "document.querySelectorAll('#cameras .camera').length === 3")
        heights = page.evaluate(
            "[...document.querySelectorAll('#cameras figure')].map((each) => each.clientHeight)"
        )
        assert max(heights) - min(heights) <= 1
        assert "37\u00a0% der Pixel sind gesättigt" in read_text(
            page, ".camera[data-state=unusable] .message"
        )
        page.context.close()
    finally:
        del plant.send_health
    assert site.errors == []


def test_sign_out_on_a_phone(site):
    page = site.page("/?lang=en", wide=360, high=740)
    wait_until_live(page)
    button = page.locator("#who button")
    assert button.is_visible() and button.inner_text() == "Sign out"
    box = button.bounding_box()
    assert box["x"] >= 0 and box["x"] + box["width"] <= 360
    page.evaluate("location.hash = '#history'")
    page.wait_for_selector("#history-days td")
    cells = "[...document.querySelectorAll('#history-days td, #history-events td')]"
    cut = f"{cells}.filter((cell) => cell.getBoundingClientRect().right > 360).length"
    assert page.evaluate(cut) == 0
    button.click()
    page.wait_for_url("**/login")
    assert site.errors == []
    page.context.close()


def test_maintenance_begins_is_displayed_and_ends(site):
    page = site.page("/?lang=en")
    wait_until_live(page)
    page.click("#maintenance-begin")
    page.fill("#maintenance-reason", "cleaning the windows")
    page.select_option("#maintenance-minutes", "15")
    page.click("#maintenance-dialog .main")
    page.wait_for_selector("#maintenance:visible")
    assert "cleaning the windows (ana" in read_text(page, "#maintenance-text")
    wait_for(page, "document.querySelector('#flow-volume').innerText === '–'")
    assert read_text(page, "#flow-standing") == "Maintenance"
    assert site.works.plant.maintenance is not None
    (entry,) = [one for one in site.works.access.audit.read_last(50) if one["what"] == "begin_maintenance"]
    assert entry["who"] == "ana"
    page.click("#maintenance-end")
    page.wait_for_selector("#maintenance", state="hidden")
    wait_for(page, "document.querySelector('#flow-volume').innerText.length > 1")
    assert site.works.plant.maintenance is None and site.errors == []
    page.context.close()


FINDINGS = (
    Finding(
        "dirt",
        6.2,
        0.5,
        2.0,
        "%",
        "cam2",
        "cam2: dirt at the marked place",
        "degraded",
        place=(0.5, 0.2, 0.8, 0.5),
    ),
    Finding("zero_shift", 0.3, 0.1, 2.0, "mm"),
    Finding("encoder_motion", nan, nan, 0.02, ""),
)


@pytest.mark.parametrize(("language", "wide"), [("en", 1300), ("de", 360), ("zh", 1300)])
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


def test_engineers_set_the_zero_after_seeing_what_was_measured(site):
    plant = site.works.plant
    plant.zero_refusal = Message("zero: only 40% of the belt is bare", "zero_set_not_bare", share=40)
    page = site.page("/?lang=de#health", high=740, user="eva")
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
    assert [error for error in site.errors if "409" not in error] == []
    site.errors.clear()
    page.context.close()


def test_operators_do_not_see_the_checks(site):
    page = site.page("/#health")
    wait_until_live(page)
    assert not page.locator("#to-health").is_visible() and not page.locator("#health-view").is_visible()
    assert page.locator("#live-view").is_visible()
    page.context.close()


def test_events_are_in_the_pages_language(site):
    history = site.works.history
    history.add_event(
        "alarm", "camera_lost:cam3", "raised: no image for 4 s; check its power",
        parameters={"state": "raised", "cause": "silent", "values": {"seconds": 4}},
    )  # fmt: skip
    history.add_event(
        "alarm", "oversize_lump", "raised: a lump of 230 mm",
        parameters={"state": "raised", "value": 230.0, "limit": 200.0, "unit": "mm"},
    )  # fmt: skip
    history.add_event("alarm", "slip", "gone: encoder and material differ by 5 %")  # of an older version
    history.add_event("maintenance", "begin", "x", parameters={"reason": "Reinigung", "minutes": 30.0})
    page = site.page("/?lang=de#history")
    page.wait_for_selector("#history-events td")
    wait_for(page, "document.querySelectorAll('#history-events tbody tr').length >= 4")
    text = read_text(page, "#history-events")
    assert "Kamera verloren: cam3 – anstehend: Seit 4 s kein Bild" in text
    assert "Überkorn – anstehend: 230\u00a0mm, Grenze 200\u00a0mm" in text
    assert "Wartung beginnt: Reinigung, höchstens 30 min" in text
    assert "check" not in text and "differ" not in text
    page.context.close()
