"""Every button of a commissioning's page, pressed by keys in a real browser; what a screen reader finds there."""

from __future__ import annotations

import json
import re
from collections.abc import Generator
from pathlib import Path

import pytest
from playwright.sync_api import sync_playwright

from beltscape.commissioning.material import write_test
from beltscape.commissioning.state import FILE, CommissionState
from beltscape.commissioning.steps import STEPS
from beltscape.core.errors import SettingsError
from beltscape.files.toml_text import read_toml
from beltscape.service.settings import read_texts
from tests.commissioning.served_plant import Keyboard, ServedPlant, count_views, wait
from tests.commissioning.test_page import RESULTS
from tests.once import make_once
from tests.service.page.site import needs_chromium
from tests.synthetic.small_demo import make_small_demo

TEXTS = read_texts("en")
SAMPLES = {
    "density_kg_m3": 1600.0,
    "density_sigma_kg_m3": 8.0,
    "moisture_percent": 6.0,
    "moisture_sigma_percent": 0.2,
}


def test_samples_are_in_the_material_test_s_file_with_their_sigma(tmp_path: Path) -> None:
    state = CommissionState(tmp_path)
    runs = [{"load": load, "capture": load, "volume_m3": 1.0} for load in ("half", "full")]
    state.change_settings({"runs": runs, "samples": SAMPLES})
    write_test(state)
    written = read_toml(tmp_path / "material_test.toml")
    assert written["density"] == {"kg_m3": 1600.0, "sigma_kg_m3": 8.0}
    assert written["moisture"] == {"percent": 6.0, "sigma_percent": 0.2}
    with pytest.raises(SettingsError, match="moisture_sigma_percent; no sample is known exactly"):
        state.change_settings({"samples": {"moisture_percent": 6.0}})


@pytest.fixture
def desk(tmp_path, tmp_path_factory) -> Generator[tuple[Keyboard, ServedPlant]]:
    """A served trial plant, empty yet, and a keyboard before its page."""
    plant = ServedPlant(
        tmp_path / "plant", make_once(tmp_path_factory, "four_camera_demo", make_small_demo), 0.02
    )
    plant.start()
    with sync_playwright() as playwright:
        hand = Keyboard(playwright, plant)
        yield hand, plant
        hand.browser.close()
    plant.close()


def read_settings(plant: ServedPlant) -> dict:
    path = plant.folder / FILE
    return json.loads(path.read_text())["settings"] if path.is_file() else {}


def show(hand: Keyboard, step: str) -> None:
    hand.press(f'#steps li[data-key="{step}"] button')
    hand.page.wait_for_selector(f'#steps li[data-key="{step}"] button[aria-current="step"]')
    assert hand.page.evaluate("document.activeElement.id") == "step-title"


@pytest.mark.thorough
@pytest.mark.browser
@needs_chromium
def test_every_button_is_pressed_by_keys(desk) -> None:
    hand, plant = desk
    choose_source(hand, plant)
    use_tools(hand)
    run_and_cancel(hand, plant)
    take_views(hand, plant)
    finish_all(plant)
    hand.close()
    hand.open("/#material")
    answer_material_test(hand, plant)
    refuse_and_mend(hand, plant)
    hand.press("#who button")  # signs out
    hand.page.wait_for_url("**/login")
    assert [one for one in hand.errors if "409" not in one] == []


def choose_source(hand: Keyboard, plant: ServedPlant) -> None:
    """A folder that is not there is refused in a line that is read out; cameras are searched; then the trial."""
    hand.press('input[name="source"]:checked', "ArrowDown")
    hand.write('input[name="captures"]', "nowhere")
    hand.press("#do-run")
    hand.wait_for_step("cameras", "failed")
    problem = hand.page.locator("#step-problem")
    assert "nowhere/calibration" in problem.inner_text()
    assert problem.get_attribute("role") == "alert"
    assert f"status: {TEXTS['commission.status.failed']}" in hand.page.locator("body").aria_snapshot()
    hand.press('input[name="source"]:checked', "ArrowDown")
    search = hand.page.get_by_role("button", name=TEXTS["commission.search"])
    search.focus()
    hand.page.keyboard.press("Enter")
    wait(
        lambda: hand.page.inner_text("#found") not in ("", TEXTS["commission.searching"]),
        "the search answers",
        60,
    )
    hand.press('input[name="source"]:checked', "ArrowUp")
    hand.press('input[name="source"]:checked', "ArrowUp")
    hand.press("#do-run")
    hand.wait_for_step("cameras", "done")
    assert read_settings(plant)["source"] == "trial"
    wait(
        lambda: hand.page.evaluate("document.activeElement.id") == "do-next",
        "the keyboard is at the next step",
        60,
    )


def use_tools(hand: Keyboard) -> None:
    """Theme and language, and the commands of the terminal."""
    theme = hand.page.evaluate("document.documentElement.dataset.theme ?? ''")
    hand.press("#theme")
    wait(
        lambda: hand.page.evaluate("document.documentElement.dataset.theme ?? ''") != theme,
        "another theme",
        60,
    )
    hand.page.focus("#language")
    hand.page.select_option("#language", "zh")
    chinese = read_texts("zh")
    wait(lambda: hand.page.inner_text("#step-title") == chinese["commission.step.cameras"], "Chinese", 60)
    assert "commission." not in hand.page.inner_text("main")
    hand.page.select_option("#language", "en")
    hand.press("#step-terminal summary")
    assert "--step cameras" in hand.page.inner_text("#step-commands")


def run_and_cancel(hand: Keyboard, plant: ServedPlant) -> None:
    """The button that took the pressed one's place has the focus; a step that is cancelled stays open."""
    show(hand, "board")
    hand.press("#do-run")
    hand.page.wait_for_selector("#do-cancel:focus")
    hand.page.keyboard.press("Enter")  # the second press of a hasty hand
    hand.page.wait_for_timeout(1100)
    if plant.get_status("board") == "running":
        hand.page.keyboard.press("Enter")
    hand.page.wait_for_selector('#steps li[data-key="board"]:not([data-status="running"])')
    if plant.get_status("board") != "done":
        assert hand.page.inner_text("#step-problem") == TEXTS["commission.cancelled"]
        hand.press("#do-run")
        hand.wait_for_step("board", "done")


def take_views(hand: Keyboard, plant: ServedPlant) -> None:
    """Views by themselves and by hand, with sound; stopped, begun anew; what is read out meanwhile."""
    show(hand, "calibrate")
    hand.press("#views-start")
    hand.page.wait_for_selector("#views-eyes .ghost")
    hand.press("#views-sound", "Space")
    assert hand.page.locator("#views-sound").is_checked()
    wait(lambda: count_views(plant.folder) >= 1, "a view")
    hand.page.wait_for_selector("#views-anew:visible")
    tree = hand.page.locator("body").aria_snapshot()
    for name in ("take", "stop", "anew"):
        assert f'button "{TEXTS[f"commission.views.{name}"]}"' in tree
    assert f'checkbox "{TEXTS["commission.views.sound"]}"' in tree
    assert 'img "Picture of cam0"' in tree
    assert re.search(r"- status:\n\s+- strong: ", tree), "what to do is read out"
    hand.press("#views-take")
    taken = count_views(plant.folder)
    wait(lambda: count_views(plant.folder) > taken, "a further view")
    hand.press("#views-anew")
    wait((plant.folder / "calibration_1").is_dir, "the views are set aside", 60)
    hand.press("#views-stop")
    hand.page.wait_for_selector("#views-start")


def finish_all(plant: ServedPlant) -> None:
    """Let all steps be finished, with results that nobody measured."""
    state = CommissionState(plant.folder)
    for step in STEPS:
        for name in step.outputs:
            path = plant.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if not path.exists():
                path.write_text("{}")
        state.finish(step.name, RESULTS[step.name], ())
    state.change_settings({"runs": []})


def answer_material_test(hand: Keyboard, plant: ServedPlant) -> None:
    """Fields and stamps; every stamp is on the disk when its button has answered."""
    hand.write('input[name="samples.density_kg_m3"]', "1600")
    hand.write('input[name="samples.density_sigma_kg_m3"]', "8")
    hand.write('input[name="zero.belt_length_m"]', "40")
    hand.press('[data-stamp="zero begin"]')
    wait(lambda: read_settings(plant).get("zero", {}).get("begin"), "the zero begins", 60)
    wait(
        lambda: hand.page.evaluate("document.activeElement.dataset.stamp") == "zero begin",
        "the focus stays",
        60,
    )
    assert read_settings(plant)["samples"]["density_sigma_kg_m3"] == 8
    hand.write('[data-run="0"] input[data-key="load"]', "half")
    hand.write('[data-run="0"] input[data-key="mass_kg"]', "5760")
    hand.press('[data-stamp="0 begin"]')
    wait(lambda: read_settings(plant)["runs"] or hand.page.inner_text("#step-problem"), "the run begins", 60)
    assert read_settings(plant)["runs"], hand.page.inner_text("#step-problem")
    wait(
        lambda: "–" not in hand.page.inner_text('[data-run="0"] summary').split(";")[0],
        "the moment is shown",
        60,
    )
    hand.press('[data-stamp="0 end"]')
    wait(lambda: read_settings(plant)["runs"][0].get("end"), "the run ends", 60)
    (run,) = read_settings(plant)["runs"]
    assert (run["load"], run["mass_kg"]) == ("half", 5760)
    assert run["begin"] < run["end"]


def refuse_and_mend(hand: Keyboard, plant: ServedPlant) -> None:
    """A wrong value is refused before the step runs; doubts are accepted by a key."""
    hand.write('input[name="samples.density_sigma_kg_m3"]', "")
    hand.page.keyboard.press("Delete")
    hand.press("#do-run")
    wait(lambda: "no sample is known exactly" in hand.page.inner_text("#step-problem"), "it is refused", 60)
    show(hand, "rig")
    hand.press('input[name="accept_doubts"]', "Space")
    hand.press("#do-run")
    wait(lambda: read_settings(plant).get("accept_doubts"), "doubts are accepted", 60)
    show(hand, "certificate")
    assert hand.page.get_by_label(TEXTS["commission.field.operator"]).is_editable()
