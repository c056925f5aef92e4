"""The server of a commissioning is killed in its steps: nothing is lost, no command outlives it, steps go on."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import threading
from collections.abc import Generator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import pytest

from beltscape.commissioning import guided, trial
from beltscape.commissioning.guided import GuidedSession
from beltscape.commissioning.live import LiveView, collect_complete, open_source
from beltscape.commissioning.state import FILE, CommissionState
from beltscape.commissioning.steps import STEPS
from beltscape.core.errors import InputError
from beltscape.pipeline.recording.shots import CornerCounter
from beltscape.service.settings import read_texts
from tests.commissioning.served_plant import Keyboard, ServedPlant, count_views, is_running, wait
from tests.once import make_once
from tests.service.page.site import needs_chromium
from tests.synthetic.demo import DEMO
from tests.synthetic.small_demo import make_small_demo

_BEGINNER = """
import os, subprocess, sys, time
from pathlib import Path
from beltscape.core.system_calls import begin_dependent, lock_folder
folder = Path(sys.argv[1])
lock = lock_folder(folder)
words = ("commission", "served", "--port", "0")
process = begin_dependent(words, folder, [lock], subprocess.DEVNULL, subprocess.PIPE)
while b"the page is at" not in process.stderr.readline():
    pass
os.close(lock)  # the command has inherited it
print(process.pid, flush=True)
time.sleep(600)
"""


def test_a_command_ends_when_the_program_that_began_it_is_killed(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", _BEGINNER, str(tmp_path)], stdout=subprocess.PIPE
    ) as beginner:
        assert beginner.stdout is not None
        command = int(beginner.stdout.readline())
        with pytest.raises(InputError, match="another program runs a step"), CommissionState(tmp_path).lock():
            pass
        beginner.kill()
        wait(lambda: not is_running(command), "the command ends", 60)
    wait(lambda: is_free(tmp_path), "its lock ends with its last thread", 60)


def is_free(folder: Path) -> bool:
    """Return whether no program runs a step in a folder."""
    with suppress(InputError), CommissionState(folder).lock():
        return True
    return False


def test_what_a_killed_program_has_half_copied_is_made_anew(tmp_path, tmp_path_factory, monkeypatch) -> None:
    demo = make_once(tmp_path_factory, "four_camera_demo", make_small_demo)
    monkeypatch.setattr(trial, "DEMO_FOLDER", demo)
    copied, copy = [], trial._copy

    def copy_half(scene: Path, to: Path) -> None:
        if len(copied) == 3:
            (to / "cam0").mkdir(parents=True)
            raise KeyboardInterrupt
        copied.append(scene)
        copy(scene, to)

    monkeypatch.setattr(trial, "_copy", copy_half)
    state = CommissionState(tmp_path / "plant")
    with pytest.raises(KeyboardInterrupt):
        trial.make_trial(state)
    monkeypatch.setattr(trial, "_copy", copy)
    answers = trial.make_trial(state)
    for run in answers["runs"]:
        images = sorted(path.name for path in (state.folder / run["capture"]).glob("cam*"))
        assert images == ["cam0", "cam1", "cam2", "cam3"]
    assert not list((state.folder / trial.CAPTURES).glob(".*")), "nothing half is left"


def test_a_score_of_views_that_were_set_aside_is_not_that_of_the_new_ones(
    tmp_path, tmp_path_factory, monkeypatch
) -> None:
    demo = make_once(tmp_path_factory, "four_camera_demo", make_small_demo)
    state = CommissionState(tmp_path / "plant")
    shutil.copytree(demo / "calibration", state.folder / "calibration")
    (state.folder / "board").mkdir()
    shutil.copy(demo / "board.toml", state.folder / "board")
    monkeypatch.setattr(CornerCounter, "detect", lambda *_: {})
    views = len(list((demo / "calibration/cam0").glob("*")))
    for scored, is_known in ((views, True), (views + 1, False)):
        verdict = SimpleNamespace(views=scored)
        monkeypatch.setattr(guided, "read_verdict", lambda *_, found=verdict: found)
        session = GuidedSession(state, LiveView(lambda: open_source(state)))
        session.resume()
        assert (session.verdict is verdict) == is_known
    session.set_aside()
    again = GuidedSession(state, LiveView(lambda: open_source(state)))
    again.resume()
    assert (again.taken, again.verdict) == (0, None)


def test_no_thread_draws_on_when_pictures_are_closed(tmp_path, tmp_path_factory, monkeypatch) -> None:
    """A program that ended meanwhile was aborted by its library of images."""
    demo = make_once(tmp_path_factory, "four_camera_demo", make_small_demo)
    monkeypatch.setattr(trial, "DEMO_FOLDER", demo)
    state = CommissionState(tmp_path / "plant")
    state.change_settings({"source": "trial"})
    state.change_settings(trial.make_trial(state))
    assert len(collect_complete(open_source(state), 1, threading.Event())) == 1
    live = LiveView(lambda: open_source(state))
    live.open()
    assert live.take(60) is not None
    live.close()
    assert not {"feed", "live view"} & {one.name for one in threading.enumerate()}


@pytest.fixture
def served(tmp_path, tmp_path_factory, request) -> Generator[ServedPlant]:
    demo = (
        DEMO
        if request.param == "shipped"
        else make_once(tmp_path_factory, "four_camera_demo", make_small_demo)
    )
    plant = ServedPlant(tmp_path / "plant", demo, 0.02)
    plant.start()
    yield plant
    plant.close()


@pytest.mark.parametrize("served", ["small"], indirect=True)
def test_a_step_goes_on_after_its_server_was_killed(served: ServedPlant) -> None:
    served.post("settings", {"changes": {"source": "trial"}})
    served.run_step("cameras")
    before = json.loads((served.folder / FILE).read_text())
    served.post("run/board")
    served.wait_for_command("board")
    served.kill()
    assert json.loads((served.folder / FILE).read_text()) == before
    served.start()
    assert served.get_status("board") == "open"
    served.run_step("board")


@pytest.mark.thorough  # the trial plant at its full size, every step twice
@pytest.mark.browser
@needs_chromium
@pytest.mark.parametrize("served", ["shipped"], indirect=True)
def test_every_step_outlives_a_killed_server_a_cut_network_and_a_closed_browser(served: ServedPlant) -> None:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        hand = Keyboard(playwright, served)
        for step in STEPS:
            take_views_twice(hand, served) if step.name == "calibrate" else None
            run_twice(hand, served, step.name)
            if step.name != STEPS[-1].name:
                hand.press("#do-next")
        assert hand.errors == []
        hand.browser.close()
    state = CommissionState(served.folder)
    assert [one["status"] for one in served.read()["steps"]] == ["done"] * len(STEPS)
    record = state.get_record("material")
    assert record is not None
    for error in record["result"]["errors"]:
        assert abs(error["value"]) < 3 * error["sigma"], error


def run_twice(hand: Keyboard, served: ServedPlant, name: str) -> None:
    """Begin a step and kill the server in its midst; then run it, with the network cut or the browser closed."""
    hand.press("#do-run")
    hand.page.wait_for_selector(f'#steps li[data-key="{name}"]:not([data-status="open"])')
    before = served.read()
    served.kill()
    served.start()
    after = served.read()
    hand.page.wait_for_selector("body[data-link=live]")
    kept = [one["name"] for one in before["steps"] if one["status"] == "done"]
    assert [one["name"] for one in after["steps"] if one["status"] == "done" and one["name"] in kept] == kept
    assert name == "cameras" or before["settings"] == after["settings"]
    if served.get_status(name) == "done":
        assert name in ("cameras", "images", "trigger", "rig"), f"{name} was over before it was killed"
        return
    hand.wait_for_step(name, "open")
    hand.press("#do-run")
    hand.page.wait_for_selector(f'#steps li[data-key="{name}"]:not([data-status="open"])')
    if name == "empty":
        cut_network(hand)
    if name == "live":
        hand.close()
        hand.open(f"/#{name}")
    hand.page.wait_for_selector(
        f'#steps li[data-key="{name}"]:not([data-status="running"]):not([data-status="open"])'
    )
    assert served.get_status(name) == "done", hand.page.inner_text("main")


def cut_network(hand: Keyboard) -> None:
    """Cut the browser off: the page says so, and finds back by itself."""
    hand.page.context.set_offline(True)
    hand.page.wait_for_selector("body[data-link=lost]")
    assert hand.page.locator("#banner").is_visible()
    if hand.page.locator("#do-cancel").count():
        hand.press("#do-cancel")
        text = read_texts("en")["commission.unsent"]
        wait(
            lambda: hand.page.inner_text("#step-problem") == text, "a press without a network is answered", 60
        )
    hand.page.context.set_offline(False)
    hand.page.wait_for_selector("body[data-link=live]")


def take_views_twice(hand: Keyboard, served: ServedPlant) -> None:
    """Take views, kill the server while they are taken and while they are scored, and go on until it is enough."""
    hand.press("#views-start")
    wait(lambda: count_views(served.folder) >= 3, "three views")
    served.kill()
    taken = count_views(served.folder)
    served.start()
    hand.page.wait_for_selector("body[data-link=live]")
    hand.press("#views-start")
    wait(lambda: (served.read()["views"] or {}).get("is_scoring"), "a score is computed")
    assert served.read()["views"]["taken"] > taken
    taken = served.read()["views"]["taken"]
    served.kill()
    served.start()
    hand.page.wait_for_selector("body[data-link=live]")
    hand.press("#views-start")
    wait_until_enough(served)
    assert served.read()["views"]["taken"] >= taken
    cut_network(hand)


def wait_until_enough(served: ServedPlant) -> None:
    """Wait for enough views as long as views and scores come, however slow the machine is."""

    def read() -> tuple[object, ...]:
        views = served.read()["views"] or {}
        return tuple(views.get(key) for key in ("is_enough", "taken", "is_scoring", "trouble"))

    before = read()
    while not before[0]:
        wait(lambda seen=before: read() != seen, f"a view is taken, or a score begins or ends: {before}")
        before = read()
