"""Simulated GenICam cameras are walked from nothing to the live test, in the terminal and on the page."""

from __future__ import annotations

import json
from collections.abc import Generator, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from beltscape.cli.main import main
from beltscape.commissioning.state import CommissionState
from beltscape.commissioning.steps import STEPS, get_status
from beltscape.core.frames import Image, to_grey
from beltscape.core.geometry.pose import Pose, rotation_from_vector
from beltscape.core.geometry.rig import Rig, scale_camera
from beltscape.files.capture import read_capture
from beltscape.files.encoder_csv import read_encoder
from beltscape.files.images import read_image
from beltscape.simulate.board_pictures import BoardPictures
from beltscape.sources.fake_genicam.camera import COUNTER
from beltscape.sources.fake_genicam.simulated_cameras import SimulatedCameras
from beltscape.target.board import corner_points_mm, read_board
from beltscape.target.planar_boards import SquareBoard
from tests.commissioning.served_plant import Keyboard, ServedPlant, wait
from tests.service.page.site import needs_chromium
from tests.sources.genicam.conftest import fake_network  # noqa: F401
from tests.stereo.rendered import RENDERED, needs_rendered, read_halved_rig
from tests.synthetic.demo import DEMO

pytestmark = [needs_rendered, pytest.mark.thorough, pytest.mark.cameras]  # each walk takes minutes
CAMERAS = ("cam0", "cam1", "cam2")
SIZE_PX = (306, 256)
RATE_HZ, RESTS = 8.0, 16
"""Frame sets a second, five of which a swing is fitted from in 0.8 s; and how many a view of the board stays."""
EXPOSURE_US, MM_PER_COUNT = 1000.0, 0.1
SWINGS = 24
"""Instants of the swung board, after which it is where it began."""
TO_LIVE = [step.name for step in STEPS[:10]]
ANSWERS = {
    "source": "cameras",
    "exposure_us": EXPOSURE_US,
    "frames_per_s": RATE_HZ,
    "packet_size": 9000,
    "allowed_skew_ms": 45,
    "instants": 12,
    "skew_limit_ms": 60,
    "belt_mm_s": 800,
    "seconds": 6,
    "tolerance_mm": 0.5,
    "load_mm": 200,
    "accept_doubts": True,
    "board": {"file": str(RENDERED / "board.toml")},
    "encoder": {"kind": "camera"},
    "camera_encoder": {"feature": COUNTER, "mm_per_count": MM_PER_COUNT},
}
"""What an engineer answers; the board is small in images of a quarter of the width."""
LONGER = {"instants": 2 * SWINGS}
"""What is answered before the board is swung."""


class SceneCameras:
    """The cameras over a belt: before them stands now this, now that."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._shown = folder, 0
        self._cameras: SimulatedCameras | None = None
        self.devices: dict[str, str] = {}

    def show(self, pictures: dict[str, list[Image]], counts: Sequence[int] = (), per_round: int = 0) -> None:
        """Put pictures before the cameras, each shown for one instant, again and again."""
        self.close()
        self._shown += 1
        folder = self._folder / str(self._shown)
        self._cameras = SimulatedCameras(folder, pictures, RATE_HZ, counts, per_round, EXPOSURE_US)
        self.devices = self._cameras.devices
        self._cameras.start()

    def show_for(self, step: str) -> None:
        """Put before the cameras what a step needs."""
        if step in ("cameras", "calibrate"):
            views = read_pictures("calibration")
            self.show({name: [view for view in own for _ in range(RESTS)] for name, own in views.items()})
        elif step == "skew":
            self.show(swing_board())
        elif step == "empty":
            self.show({name: add_noise(own[0]) for name, own in read_pictures("belt_empty").items()})
        elif step == "live":
            readings = read_encoder(RENDERED / "belt_moving/encoder.csv")
            counts = [round(one.belt_position_mm / MM_PER_COUNT) for one in readings]
            self.show(
                read_pictures("belt_moving"), counts, counts[-1] + round(counts[-1] / (len(counts) - 1))
            )

    def close(self) -> None:
        """Take the cameras away."""
        if self._cameras is not None:
            self._cameras.close()


def read_pictures(scene: str) -> dict[str, list[Image]]:
    """Return each camera's images (256, 306) uint8 of a rendered scene."""
    files = read_capture(RENDERED / scene).files
    return {name: [shrink(read_image(path)) for path in files[name].values()] for name in CAMERAS}


def shrink(image: Image) -> Image:
    return cv2.resize(to_grey(image), SIZE_PX, interpolation=cv2.INTER_AREA).round().astype(np.uint8)


def add_noise(image: Image) -> list[Image]:
    """Return an image a few times with noise of a grey level: a camera that repeats one is out of order."""
    rng = np.random.default_rng(0)
    noisy = (image + rng.normal(0.0, 1.0, image.shape) for _ in range(8))
    return [np.clip(np.rint(one), 0, 255).astype(np.uint8) for one in noisy]


def swing_board() -> dict[str, list[Image]]:
    """Return the pictures of a board that swings before the cameras, and is at the end where it began."""
    halved = read_halved_rig()
    cameras = {name: scale_camera(halved.cameras[name], 0.5) for name in CAMERAS}
    rig = Rig("cam0", cameras, {name: halved.cam_from_core[name] for name in CAMERAS})
    board = read_board(RENDERED / "board.toml")
    assert isinstance(board, SquareBoard)
    empty = {name: own[0] for name, own in read_pictures("belt_empty").items()}
    pictures, points = BoardPictures(rig, board, empty), corner_points_mm(board)
    lens, extent = rig.core_camera, np.ptp(points[:, 0])
    depth = float(lens.focal_px[0] * extent / (0.55 * lens.size_px[0]))
    found: dict[str, list[Image]] = {name: [] for name in CAMERAS}
    for number in range(SWINGS):
        phase = 2 * np.pi * number / SWINGS
        away = np.array([0.15 * np.sin(phase), 0.1 * np.sin(phase + 1), 0.06 * np.sin(phase + 2)])
        turn = rotation_from_vector(np.array([0.2 * np.sin(phase), 0.2 * np.sin(phase + 1.6), 0.0]))
        pose = Pose.placing(turn, points.mean(axis=0), depth * (np.array([0.0, 0.0, 1.0]) + away))
        for name, image in pictures.render(pose, number).items():
            found[name].append(image)
    return found


@pytest.fixture
def bench(fake_network, tmp_path) -> Generator[SceneCameras]:  # noqa: F811
    cameras = SceneCameras(tmp_path / "bench")
    yield cameras
    cameras.close()


def check_live(plant: Path) -> None:
    """Hold that all steps are done and the live test measured the belt that the cameras counted."""
    state = CommissionState(plant)
    assert [get_status(state, step) for step in STEPS[:10]] == ["done"] * 10
    found = {}
    for name in TO_LIVE:
        record = state.get_record(name)
        assert record is not None
        found[name] = record["result"]
    print(json.dumps(found, indent=1))
    assert found["cameras"]["names"] == list(CAMERAS)
    assert found["images"]["exposure_us"] == dict.fromkeys(CAMERAS, EXPOSURE_US)
    assert found["trigger"]["incomplete"] == 0
    assert set(found["skew"]["delays"]) == set(CAMERAS[1:])
    live = found["live"]
    assert live["records"] >= 20
    assert live["belt_m"] > 1
    assert live["litres"] > 1, "a heap passed"


def test_from_bare_cameras_to_the_live_test_in_the_terminal(bench, tmp_path, capsys) -> None:
    plant = tmp_path / "plant"
    for step in TO_LIVE:
        bench.show_for(step)
        if step == "cameras":
            CommissionState(plant).change_settings({**ANSWERS, "devices": bench.devices})
        elif step == "skew":
            CommissionState(plant).change_settings(LONGER)
        code = main(["commission", str(plant), "--step", step])
        assert code == 0, (step, capsys.readouterr().err)
    check_live(plant)


@pytest.mark.browser
@needs_chromium
def test_from_bare_cameras_to_the_live_test_on_the_page(bench, tmp_path) -> None:
    from playwright.sync_api import sync_playwright

    served = ServedPlant(tmp_path / "plant", DEMO, 0.02)
    served.start()
    try:
        bench.show_for("cameras")
        served.post("settings", {"changes": {**ANSWERS, "devices": bench.devices}})
        with sync_playwright() as playwright:
            hand = Keyboard(playwright, served)
            for step in TO_LIVE:
                if step != "cameras":
                    hand.press("#do-next")
                    bench.show_for(step)
                if step == "skew":
                    hand.write('[name="instants"]', str(LONGER["instants"]))
                if step == "calibrate":
                    hand.press("#views-start")
                    wait(lambda: (served.read()["views"] or {}).get("is_enough"), "the views are enough")
                hand.press("#do-run")
                hand.page.wait_for_selector(
                    f'#steps li[data-key="{step}"]:not([data-status="open"]):not([data-status="running"])'
                )
                assert served.get_status(step) == "done", (step, hand.page.inner_text("main"))
            assert hand.errors == []
            hand.browser.close()
    finally:
        served.close()
    check_live(served.folder)
