"""The drift of a rig through ``beltscape run``: estimated, shown, taken, reloaded and undone while the plant runs."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from beltscape.cli.main import main
from beltscape.core.progress import Silent
from beltscape.files.images import read_image, write_image
from beltscape.files.json_text import hash_file, read_json
from beltscape.files.rig_json import read_rig
from beltscape.pipeline.calibrating.drift import RigDrift, assess_drift
from beltscape.service.access import Access
from beltscape.service.project import open_project
from beltscape.stereo.consistency.drift import NOTHING, apply_drift
from tests.pipeline.live.conftest import PROJECT
from tests.service.access.sample_app import CHEAP, PASSWORD
from tests.service.running import open_session

pytestmark = pytest.mark.thorough

TURNED, TURN = "cam1", np.array([7e-4, -5e-4, 0.0, 0.0, 0.0, 0.0, 0.0])
"""A camera that is turned by a third of a pixel."""
WATCH = "[watch]\ndrift_every_s = 0.01\ndrift_frames = 20\n"
PATIENCE_S = 600


@dataclass(frozen=True)
class Running:
    """A plant that runs, and the address of its page."""

    project: Path
    address: str


def turn_camera(folder: Path) -> None:
    """Replace the images of a camera by those that it would take turned about its centre."""
    rig = read_rig(folder / "rig.json")
    camera, before = rig.cameras[TURNED], rig.cam_from_core[TURNED]
    turn = (apply_drift(rig, {TURNED: TURN}).cam_from_core[TURNED] @ before.inverse()).rotation
    pixels = np.stack(np.meshgrid(*map(np.arange, camera.size_px)), axis=-1).reshape(-1, 2).astype(np.float64)
    rays = np.column_stack([camera.undistort(pixels), np.ones(len(pixels))])
    source = camera.project(rays @ turn).reshape(*camera.size_px[::-1], 2).astype(np.float32)
    for path in sorted((folder / "belt" / TURNED).iterdir()):
        image = cv2.remap(read_image(path), source, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        part = folder / path.name
        write_image(part, np.asarray(image, np.uint8))
        part.replace(path)


@pytest.fixture
def running(plant: Path):
    plant.write_text(PROJECT.replace("[encoder]", "loop = true\n[encoder]") + WATCH)
    access = Access(plant.parent / "data", cost=CHEAP)
    access.accounts.add("anna", "engineer", PASSWORD)
    access.close()
    log = plant.parent / "log"
    with log.open("wb") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "beltscape", "run", str(plant)], stderr=file, stdout=subprocess.DEVNULL
        )
    try:
        wait_until(lambda: "the page is at " in log.read_text())
        line = next(line for line in log.read_text().splitlines() if "the page is at " in line)
        yield Running(plant, line.rpartition(" ")[2])
    finally:
        process.send_signal(signal.SIGTERM)
        assert process.wait(120) == 0


def wait_until(is_so: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < deadline
        time.sleep(0.5)


def read_drift(project: Path) -> RigDrift:
    return assess_drift(open_project(project), Silent())


def find_moved(project: Path) -> str | None:
    newest = read_drift(project).newest
    return None if newest is None else newest.document["moved"]


def test_a_camera_that_turns_while_the_plant_runs_is_proposed_taken_and_undone(running, capsys) -> None:
    project, folder = running.project, running.project.parent
    before = (folder / "rig.json").read_bytes()
    wait_until(lambda: find_moved(project) is not None)
    assert find_moved(project) == NOTHING
    turn_camera(folder)
    wait_until(lambda: find_moved(project) == TURNED)
    estimate = read_drift(project).estimates[-1]
    with open_session(running) as client:
        found = client.get("/api/drift").json()
        assert (found["moved"], found["has_proposal"], found["can_undo"]) == (TURNED, True, False)
        number = found["newest"]
        assert main(["drift", str(project), "--take", str(number), "--by", "anna"]) == 0
        assert main(["reload", str(project)]) == 0
        assert "rig: rig.json" in capsys.readouterr().out
        taken = read_rig(folder / "rig.json")
        assert taken.quality["drift"]["estimate"] == number
        assert client.get("/api/drift").json()["can_undo"]
        assert client.post("/api/drift/undo").json()["can_undo"] is False
        assert (folder / "rig.json").read_bytes() == before
        wait_until(
            lambda: read_drift(project).estimates[-1].number > number
        )  # it goes on with the former rig
        again = client.get("/api/drift").json()["newest"]
        assert client.post("/api/drift/take", json={"number": again}).json()["can_undo"]
    wait_until(lambda: read_drift(project).began_ns is not None)  # the reference of the new rig
    assert [one["action"] for one in read_json(folder / "data/rigs/changes.json")["changes"]] == [
        "taken", "undone", "taken"
    ]  # fmt: skip
    changes = np.array(estimate.document["change"]).reshape(-1, 7)
    sigma = np.sqrt(np.diag(estimate.document["covariance"])).reshape(-1, 7)
    row = estimate.document["cameras"].index(TURNED)
    assert (np.abs(changes[row] - TURN)[:3] < 3 * sigma[row, :3] + 1e-4).all()
    assert hash_file(folder / "rig.json") != estimate.rig
