"""The page on phones, on a wall display and without WebGL."""

from __future__ import annotations

from dataclasses import replace
from math import nan

import pytest

from beltscape.core.alarms import Alarm
from beltscape.core.events import CameraHealth
from beltscape.core.translatable_message import Message
from tests.service.feeder import CAMERAS
from tests.service.page.site import Site, needs_chromium, read_text, wait_for, wait_until_live
from tests.thorough import THOROUGH, list_rows

pytestmark = needs_chromium


@pytest.mark.parametrize(
    ("language", "sign_out", "webgl"),
    list_rows(
        [
            ("de", "Abmelden", False),
            ("de", "Abmelden", True),
            ("en", "Sign out", False),
            ("zh", "退出登录", False),
        ],
        [("de", "Abmelden", False)],
    ),
)
def test_page_fits_a_phone_up_to_signing_out(site, language, sign_out, webgl):
    lost = Alarm("camera_lost:cam3", "warning", "raised", nan, nan, "", 1, "no image: check cable")
    site.works.plant.raise_alarm(lost)
    page = site.page(f"/?lang={language}", wide=360, high=740, has_touch=True, webgl=webgl)
    wait_until_live(page)
    page.wait_for_selector(".alarm")
    wide = "document.documentElement.scrollWidth"
    assert page.evaluate(wide) == 360
    button = page.locator("#who button")
    assert button.is_visible() and button.inner_text() == sign_out
    box = button.bounding_box()
    assert box["x"] >= 0 and box["x"] + box["width"] <= 360
    page.evaluate("location.hash = '#history'")
    page.wait_for_selector("#history-days td")
    assert page.evaluate(wide) == 360
    cells = "[...document.querySelectorAll('#history-days td, #history-events td')]"
    cut = f"{cells}.filter((cell) => cell.getBoundingClientRect().right > 360).length"
    assert page.evaluate(cut) == 0
    button.click()
    page.wait_for_url("**/login")
    assert site.errors == []
    page.context.close()


def test_on_a_phone_the_flow_stands_above_a_short_list_with_one_line_for_all_cameras(site):
    for name in CAMERAS:
        site.works.plant.raise_alarm(
            Alarm(f"frozen_image:{name}", "critical", "raised", nan, nan, "", 1, "the same image again")
        )
    page = site.page("/?lang=es", wide=390, high=844, has_touch=True)
    wait_until_live(page)
    common = page.locator(".alarm[data-key='frozen_image:*']")
    common.wait_for()
    assert "todas las cámaras" in common.inner_text()
    assert page.locator(".alarm[data-key^=frozen_image]").count() == 1
    flow, alarms, now = (page.locator(one).bounding_box() for one in ("section.flow", "#alarms", "#now"))
    assert now["y"] < flow["y"] < alarms["y"] and alarms["height"] <= 360
    assert read_text(page, "#now").startswith("Hacer ahora: ")
    wait_for(page, "document.querySelector('#section-area').innerText.includes(',')")
    page.select_option("#language", "en")
    assert "," not in read_text(page, "#section-area") and "all cameras" in common.inner_text()
    common.locator("button.acknowledge").first.click()
    page.wait_for_selector(".alarm[data-key='frozen_image:*'][data-state=acknowledged]")
    for name in CAMERAS:
        site.works.plant.raise_alarm(Alarm(f"frozen_image:{name}", "critical", "clear", nan, nan, "", None))
    assert site.errors == []
    page.context.close()


@pytest.mark.thorough
def test_wall_display_shows_everything_at_once(site):
    page = site.page("/?wall", wide=1920, high=1080)
    wait_until_live(page)
    page.wait_for_selector("#cameras .camera")
    assert page.evaluate("document.documentElement.scrollHeight") == 1080
    for name in ("flow", "belt", "alarms", "chart", "totals", "section", "cameras"):
        box = page.locator(f"section.{name}").first.bounding_box()
        assert box["y"] + box["height"] <= 1080, name
    assert not page.locator("nav").is_visible()
    assert page.locator("main button:visible").count() == 0
    assert site.errors == []
    page.context.close()


def test_negative_belt_positions_are_drawn_without_errors_and_without_webgl_from_above(tmp_path, browser):
    made = Site(tmp_path, browser, frames=0)
    made.works.plant.belt_mm = -200_000.0
    made.running.paused.clear()
    for webgl in (False, True) if THOROUGH else (False,):
        page = made.page(webgl=webgl)
        wait_for(page, "document.querySelector('#belt-none').hidden")
        page.wait_for_timeout(600)
        if not webgl:
            wait_for(page, "document.querySelector('#belt').width > 500")
            pixel = page.evaluate(
                "[...document.querySelector('#belt').getContext('2d').getImageData(590, 50, 1, 1).data]"
            )
            assert pixel[3] == 255 and max(pixel[:3]) - min(pixel[:3]) > 30
            assert page.locator("#belt-flat").is_visible()
        page.context.close()
    assert made.works.plant.belt_mm < -1000 and made.errors == []
    made.close()


@pytest.mark.thorough
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
