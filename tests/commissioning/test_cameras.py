"""Steps with GenICam cameras (simulated ones): exposure read back, one unplugged in between, guided views."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest

from beltscape.commissioning import live
from beltscape.commissioning.guided import LEAST_VIEWS, GuidedSession, take_views
from beltscape.commissioning.live import LiveView, open_source
from beltscape.commissioning.runner import StepRun
from beltscape.commissioning.session import CommissionSession
from beltscape.commissioning.state import CommissionState
from beltscape.commissioning.steps import find_step, get_status
from beltscape.core.errors import InputError
from beltscape.core.frames import to_grey
from beltscape.files.capture import read_capture
from beltscape.files.images import read_image
from beltscape.pipeline.recording import feed
from beltscape.sources.fake_genicam.simulated_cameras import SimulatedCameras
from tests.once import make_once
from tests.sources.genicam.conftest import fake_network  # noqa: F401
from tests.synthetic.small_demo import make_small_demo

CAMERAS = ("cam0", "cam1", "cam2")
RESTS, RATE_HZ = 4, 4.0
"""Frame sets that a view stays, and their rate: the second one finds it at rest."""
EXPOSURE_US = 1000.0

pytestmark = pytest.mark.cameras


class Notes:
    """A reporter that keeps what it is given."""

    def __init__(self) -> None:
        self.warnings: list[str] = []

    def step(self, stage: str, done: int, total: int) -> None:
        pass

    def warn(self, message: str) -> None:
        self.warnings.append(message)


@pytest.fixture
def bench(fake_network, tmp_path_factory, tmp_path, monkeypatch):  # noqa: F811
    """Three running cameras before which the views of a board pass, and the plant's state."""
    monkeypatch.setattr(live, "_PATIENCE_S", 6.0)
    monkeypatch.setattr(feed, "_SEQUENCE_PATIENCE_S", 6.0)
    demo = make_once(tmp_path_factory, "four_camera_demo", make_small_demo)
    capture = read_capture(demo / "calibration")
    frames = [frame for frame in capture.frames if all(frame in capture.files[name] for name in CAMERAS)]
    grey = lambda path: to_grey(read_image(path)).round().astype(np.uint8)  # noqa: E731
    views = {name: [grey(capture.files[name][frame]) for frame in frames] for name in CAMERAS}
    pictures = {name: [view for view in own for _ in range(RESTS)] for name, own in views.items()}
    state = CommissionState(tmp_path / "plant")
    with SimulatedCameras(tmp_path / "bench", pictures, RATE_HZ, exposure_us=EXPOSURE_US) as cameras:
        state.change_settings(
            {
                "source": "cameras", "devices": cameras.devices, "exposure_us": EXPOSURE_US, "packet_size": 9000,
                "frames_per_s": RATE_HZ, "allowed_skew_ms": 80, "instants": 6, "tolerance_mm": 0.3,
                "board": {"file": str(demo / "board.toml")},
            }
        )  # fmt: skip
        yield cameras, state


def run(state: CommissionState, step: str) -> tuple[dict, list[str]]:
    notes = Notes()
    return StepRun(state, notes).run(step), notes.warnings


def read_brightness(state: CommissionState) -> float:
    """Return the mean level of the core's next image."""
    source = open_source(state)
    try:
        return float(np.mean(next(iter(source)).images["cam0"]))
    finally:
        source.close()


@pytest.mark.thorough  # a minute: three steps wait for a camera that does not answer
def test_exposure_is_set_read_back_and_seen_and_an_unplugged_camera_is_named(bench):
    cameras, state = bench
    facts, _ = run(state, "cameras")
    assert facts == {"cameras": 3, "names": list(CAMERAS), "core": "cam0"}
    facts, warnings = run(state, "images")
    assert facts["exposure_us"] == dict.fromkeys(CAMERAS, EXPOSURE_US)
    assert facts["faults"] == warnings == []
    before = read_brightness(state)
    state.change_settings({"exposure_us": 0.4 * EXPOSURE_US, "gain_db": 3})
    facts, _ = run(state, "images")
    assert facts["exposure_us"] == dict.fromkeys(CAMERAS, 0.4 * EXPOSURE_US)
    assert facts["gain_db"] == pytest.approx(dict.fromkeys(CAMERAS, 3), abs=0.1)
    assert read_brightness(state) < 0.6 * before, "the cameras have taken the new exposure time"
    facts, _ = run(state, "trigger")
    assert (facts["instants"], facts["incomplete"]) == (6, 0)
    cameras.kill("cam2")
    for step in ("images", "trigger"):
        with pytest.raises(InputError, match=r"cam2.*127\.0\.0\.13"):
            run(state, step)
    assert get_status(state, find_step("trigger")) == "done", "the earlier proof stays"
    state.change_settings({"gain_db": 55})
    cameras.start("cam2")
    with pytest.raises(InputError, match="cam0: gain_db 55 is outside the camera's"):
        run(state, "images")


def test_views_are_taken_from_cameras_and_a_lost_one_is_named_on_the_page(bench):
    cameras, state = bench
    run(state, "cameras")
    run(state, "board")
    session = CommissionSession(state)
    session.handle_views("start")
    try:
        wait(lambda: session.take_snapshot()["views"]["taken"] >= 2)
        cameras.kill("cam1")
        wait(lambda: "cam1" in [one["camera"] for one in session.take_snapshot()["live"]["faults"]])
        (fault,) = (one for one in session.take_snapshot()["live"]["faults"] if one["camera"] == "cam1")
        assert fault["key"]
        taken = session.take_snapshot()["views"]["taken"]
        wait(lambda: session.take_snapshot()["views"]["taken"] > taken)  # two cameras go on
        cameras.start("cam1")
        wait(lambda: not session.take_snapshot()["live"]["faults"])
    finally:
        session.close()
    taken = len({path.stem for path in (state.folder / "calibration").glob("*/*.png")})
    again = GuidedSession(state, LiveView(lambda: open_source(state)))
    again.resume()
    assert again.taken == taken


@pytest.mark.thorough  # views of a trial plant become a rig in every run
def test_views_of_cameras_become_a_rig(bench):
    _, state = bench
    run(state, "cameras")
    run(state, "board")
    take_views(state, Notes())
    views = json.loads((state.folder / "rig/calibration.json").read_text())["training"]["frames"]
    assert views >= LEAST_VIEWS


def wait(fits, seconds: float = 60.0) -> None:
    """Wait until something holds; fail where it does not for a time that is far beyond what it takes."""
    until = time.monotonic() + seconds
    while not fits():
        assert time.monotonic() < until, "it does not come to hold"
        time.sleep(0.1)


def test_a_plant_without_cameras_says_which_do_not_answer(bench):
    cameras, state = bench
    cameras.close()
    with pytest.raises(InputError, match=r"cam0.*127\.0\.0\.11.*cam1.*127\.0\.0\.12"):
        run(state, "cameras")
    assert Path(state.folder / "cameras.toml").is_file()
    assert get_status(state, find_step("cameras")) == "open"
