"""The page of a commissioning in a real browser: the first steps, guided views, a closed browser, a phone."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from beltscape.commissioning import staged_cameras, trial
from beltscape.commissioning.serving import open_commission
from beltscape.commissioning.state import CommissionState
from beltscape.commissioning.steps import STEPS
from beltscape.service.access.accounts import User
from beltscape.service.settings import read_texts
from tests.once import make_once
from tests.service.page.site import ARGS, CHROMIUM, needs_chromium
from tests.service.plants import PASSWORD
from tests.synthetic.small_demo import make_small_demo

SLOW_MS = 120_000
"""A busy machine starts a command in seconds."""


@pytest.fixture
def demo(tmp_path_factory, monkeypatch) -> None:
    small = make_once(tmp_path_factory, "four_camera_demo", make_small_demo)
    monkeypatch.setattr(trial, "DEMO_FOLDER", small)
    monkeypatch.setattr(staged_cameras, "PERIOD_S", 0.02)


class Desk:
    """A browser before the page; it may be closed and opened again."""

    def __init__(self, playwright, address: str, token: str) -> None:
        self.address, self.token = address, token
        self.browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=ARGS)
        self.errors: list[str] = []

    def open(self, path: str = "/", wide: int = 1300, **more):
        context = self.browser.new_context(viewport={"width": wide, "height": 800}, **more)
        context.add_cookies([{"name": "beltscape", "value": self.token, "url": self.address}])
        context.set_default_timeout(SLOW_MS)
        page = context.new_page()
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("console", lambda one: self.errors.append(one.text) if one.type == "error" else None)
        page.goto(self.address + path)
        page.wait_for_selector("body[data-link=live]")
        return page


def run_step(page, name: str) -> None:
    page.click("#do-run")
    page.wait_for_selector(f'#steps li[data-key="{name}"][data-status="done"]')


@pytest.mark.browser
@needs_chromium
def test_the_trial_plant_is_walked_to_the_board_and_its_views_outlive_the_browser(
    tmp_path: Path, demo
) -> None:
    from playwright.sync_api import sync_playwright

    state = CommissionState(tmp_path / "plant")
    with open_commission(state, 0, "en") as (server, _, access), sync_playwright() as playwright:
        access.accounts.add("eva", "engineer", PASSWORD)
        access.accounts.add("ana", "viewer", PASSWORD)
        desk = Desk(playwright, server.address, access.sessions.open(User("eva", "engineer"), ""))
        page = desk.open()
        walk_to_the_board(page)
        take_views(page)
        page.context.close()
        taken = len(list((tmp_path / "plant/calibration/cam0").glob("*.png")))
        assert taken >= 2
        check_phone(desk, taken)
        check_keyboard(desk)
        desk.browser.close()
        assert desk.errors == []


RESULTS = {
    "cameras": {"cameras": 2, "names": ["cam0", "cam1"], "core": "cam0"},
    "images": {"cameras": 2, "faults": ["cam1"], "evenness": 0.7},
    "trigger": {"instants": 50, "incomplete": 0, "dropped": 0, "allowed_skew_ms": 2.0},
    "board": {"board": "charuco"},
    "calibrate": {"views": 12, "held_out_px": 0.01, "sigma_mm": 0.02, "worst_mm": 0.04, "uncovered": 0.0},
    "rig": {
        "views": 12,
        "held_out_px": 0.01,
        "sigma_mm": 0.02,
        "worst_mm": 0.04,
        "uncovered": 0.0,
        "doubts": 0,
    },
    "skew": {
        "delays": {"cam1": {"delay_ms": 0.021, "sigma_ms": 0.008, "belt_mm": 0.042, "sigma_mm": 0.016}},
        "latest": "cam1",
        "skew_limit_ms": 0.1,
    },
    "empty": {"width_mm": 800.0, "noise_mm": 0.02, "frames": 5},
    "project": {"parts": {"rig": "2 cameras", "page": "127.0.0.1"}},
    "live": {"records": 9, "litres": 18.4, "sigma_litres": 0.9, "belt_m": 2.5, "missing_share": 0.0},
    "material": {"errors": [{"key": "volume_error", "value": -0.42, "sigma": 1.7}], "notes": ["no_zero"]},
    "certificate": {"number": "2026-0001", "days": 365.0},
}
"""What each step found, as `runner` records it."""
SHOWN = {
    "images": "cam1",
    "rig": "0.01",
    "skew": "0.021",
    "live": "18.4",
    "material": "0.4",
    "certificate": "2026-0001",
}
"""A part of what the page then shows."""


@pytest.mark.browser
@needs_chromium
def test_every_finished_step_shows_what_it_found(tmp_path: Path) -> None:
    from playwright.sync_api import sync_playwright

    state = CommissionState(tmp_path / "plant")
    for step in STEPS:
        for name in step.outputs:
            path = tmp_path / "plant" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text("{}")
        state.finish(step.name, RESULTS[step.name], ())
    (tmp_path / "plant/test/report.html").write_text("<!doctype html><title>test</title>")
    with open_commission(state, 0, "en") as (server, _, access), sync_playwright() as playwright:
        access.accounts.add("eva", "engineer", PASSWORD)
        desk = Desk(playwright, server.address, access.sessions.open(User("eva", "engineer"), ""))
        page = desk.open("/#board")
        for step in STEPS:
            page.click(f'#steps li[data-key="{step.name}"] button')
            page.wait_for_selector(f'#steps li[data-key="{step.name}"] button[aria-current="step"]')
            shown = page.inner_text("main")
            assert "commission." not in shown, "a text is missing"
            assert "undefined" not in shown
            assert "NaN" not in shown
            check_names(page, step.name)
            if step.name != "board":
                page.wait_for_selector("#step-facts dd")
            assert SHOWN.get(step.name, "") in page.inner_text("#step-facts")
        check_narrow(desk)
        page.click('#steps li[data-key="material"] button')
        page.wait_for_selector('#step-files a[href="api/commission/files/test/report.html"]')
        desk.browser.close()
        # there are no cameras to open for the step of the images, which the page says
        assert [one for one in desk.errors if "409 (Conflict)" not in one] == []


@pytest.mark.browser
@needs_chromium
def test_a_failure_has_a_sentence_in_each_language_before_the_line_of_the_program(tmp_path: Path) -> None:
    from playwright.sync_api import sync_playwright

    state = CommissionState(tmp_path / "plant")
    state.change_settings({"source": "captures", "captures": "nowhere"})
    with open_commission(state, 0, "en") as (server, _, access), sync_playwright() as playwright:
        access.accounts.add("eva", "engineer", PASSWORD)
        desk = Desk(playwright, server.address, access.sessions.open(User("eva", "engineer"), ""))
        page = desk.open("/#cameras")
        page.click("#do-run")
        page.wait_for_selector('#steps li[data-key="cameras"][data-status="failed"]')
        for language in ("en", "de", "es", "zh"):
            page.select_option("#language", language)
            check_problem(page, language, "failed.cameras", "nowhere/calibration")
        page.check('input[name="source"][value="cameras"]')
        page.fill('input[name="frames_per_s"]', "-1")
        page.click("#do-run")
        check_problem(page, language, "refused.settings", "frames_per_s = -1")
        page.wait_for_timeout(1500)  # the state was read again meanwhile, with the earlier failure
        check_problem(page, language, "refused.settings", "frames_per_s = -1")
        desk.browser.close()
        assert [one for one in desk.errors if "409 (Conflict)" not in one] == []


def check_problem(page, language: str, key: str, line: str) -> None:
    """A sentence in the page's language, then the program's line, which a screen reader reads as English."""
    sentence = read_texts(language)[f"commission.{key}"]
    page.locator("#step-problem > span:first-child", has_text=sentence).wait_for()
    program = page.locator("#step-problem .program")
    assert program.inner_text().startswith(read_texts(language)["commission.program"])
    assert line in program.locator("[lang=en]").inner_text()


def check_narrow(desk: Desk) -> None:
    """No step is wider than a phone, in the language with the longest words."""
    for step in STEPS:
        phone = desk.open(f"/?lang=de#{step.name}", wide=390, has_touch=True)
        phone.wait_for_selector(f'#steps li[data-key="{step.name}"] button[aria-current="step"]')
        assert phone.evaluate("document.documentElement.scrollWidth") == 390, step.name
        phone.context.close()


def check_names(page, step: str) -> None:
    """What a screen reader finds: the list of steps, its heading and state, a name for every control."""
    tree = page.locator("body").aria_snapshot()
    texts = read_texts("en")
    assert f'navigation "{texts["commission.steps"]}"' in tree
    assert f'heading "{texts[f"commission.step.{step}"]}" [level=2]' in tree
    assert f"status: {texts['commission.status.done']}" in tree
    unnamed = re.findall(
        r"- (?:button|textbox|spinbutton|combobox|checkbox|radio|link)(?: \[[^]]*\])*:?$", tree, re.M
    )
    assert unnamed == [], tree


def walk_to_the_board(page) -> None:
    assert page.locator("#steps li").count() == len(STEPS)
    assert page.locator('input[name="source"][value="trial"]').is_checked()
    for name in ("cameras", "images", "trigger", "board"):
        assert page.locator("#step-title").inner_text() == read_texts("en")[f"commission.step.{name}"]
        if name == "images":
            page.wait_for_selector(".eye svg.bars rect", state="attached")
            page.wait_for_selector(".eye .tile")
        run_step(page, name)
        page.click("#do-next")
    page.wait_for_selector("#views-start")
    assert "beltscape calibrate calibration --board board/board.toml" in page.text_content("#step-commands")


def take_views(page) -> None:
    page.click("#views-start")
    page.wait_for_selector("#views-eyes .ghost")
    page.wait_for_selector("#views-eyes .corner")
    page.wait_for_selector("#views-eyes .cell-missing")
    while int(page.inner_text("#views-scores dd")) < 2:
        page.wait_for_timeout(100)
    page.wait_for_selector("#views-eyes .cell-reached")
    assert page.inner_text("#views-coach strong")


def check_phone(desk: Desk, taken: int) -> None:
    """The session goes on without a browser; a phone finds it as it is, in another language."""
    page = desk.open("/?lang=zh#calibrate", wide=390, has_touch=True)
    page.wait_for_selector("#views-eyes li")
    assert int(page.inner_text("#views-scores dd")) >= taken
    assert read_texts("zh")["commission.views.stop"] == page.inner_text("#views-stop")
    assert "commission." not in page.inner_text("main"), "a text is missing"
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    page.click("#views-stop")
    page.wait_for_selector("#views-start")
    page.context.close()


def check_keyboard(desk: Desk) -> None:
    """Every step is reached by the keyboard, and a later one says what comes first."""
    page = desk.open("/#board")
    page.locator('#steps li[data-key="empty"] button').focus()
    page.keyboard.press("Enter")
    page.wait_for_selector('#steps li[data-key="empty"] button[aria-current="step"]')
    assert page.evaluate("document.activeElement.id") == "step-title"
    texts = read_texts("en")
    assert page.inner_text("#step-problem") == texts["commission.first"].format(
        step=texts["commission.step.rig"]
    )
    assert page.locator("#do-run").is_disabled()
    unnamed = page.evaluate(
        "[...document.querySelectorAll('button, input, select, a')].filter((one) => !one.hidden && "
        "!(one.textContent.trim() || one.getAttribute('aria-label') || one.labels?.length)).length"
    )
    assert unnamed == 0
    page.context.close()


def test_the_interface_is_for_engineers(tmp_path: Path) -> None:
    import httpx

    state = CommissionState(tmp_path / "plant")
    with open_commission(state, 0, "en") as (server, _, access):
        access.accounts.add("ana", "operator", PASSWORD)
        access.accounts.add("eva", "engineer", PASSWORD)
        paths = ("", "/optics", "/pictures/cam0", "/files/rig/report.html")
        expected = {"": 401, "ana": 403, "eva": 200}
        for name, code in expected.items():
            cookies = {"beltscape": access.sessions.open(User(name, "engineer"), "")} if name else {}
            for path in paths:
                answer = httpx.get(f"{server.address}/api/commission{path}", cookies=cookies)
                missing = path.startswith(("/pictures", "/files")) and name == "eva"
                assert answer.status_code == (404 if missing else code), (name, path)
