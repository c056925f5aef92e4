"""Frame sets matched on worker processes: the ledger of one process, whatever happens to a worker."""

from __future__ import annotations

import os
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest

from beltscape.files.images import read_image, write_image
from beltscape.health.belt import monitor as belt_monitor
from beltscape.health.images import monitor as image_monitor
from beltscape.measure.flow import blocks, meter
from beltscape.pipeline.live.assembly import RunOptions, assemble
from beltscape.pipeline.reconstructing.match_ahead import count_workers
from beltscape.service.project import open_project
from tests.pipeline.live.feed import Watcher
from tests.reprocessing.conftest import recorded_plant  # noqa: F401
from tests.reprocessing.ledgers import read_records
from tests.thorough import list_cases
from tests.workers.processes import find_workers


@pytest.fixture
def plant(recorded_plant: Path, tmp_path: Path) -> Path:  # noqa: F811
    """The folder of a plant with a recording of a moving belt."""
    return shutil.copytree(recorded_plant, tmp_path / "plant")


def replay(plant: Path, workers: int, *, kill_at: int = -1) -> tuple[list[tuple], Killing, list[str]]:
    """Replay the plant's recording; return the records, what an observer saw, and the texts of the events.

    At the frame ``kill_at`` a worker is killed.
    """
    text = (plant / "project.toml").read_text()
    path = plant / f"workers{workers}_{kill_at}.toml"
    path.write_text(f"{text}\n[matching]\nworkers = {workers}\n")
    data, watcher = plant / path.stem, Killing(kill_at)
    run = assemble(open_project(path), RunOptions(data, paced=False, record=False), watcher)
    run.engine.start()
    assert run.engine.wait(300)
    assert run.engine.stop() == 0
    events = [event.text for event in run.historian.events(0, 1 << 62) if event.kind == "worker"]
    run.close()
    assert find_workers() == []
    return read_records(data), watcher, events


class Killing(Watcher):
    """Kills a worker at a frame."""

    def __init__(self, kill_at: int) -> None:
        super().__init__()
        self.kill_at, self.messages = kill_at, list[str]()

    def on_message(self, message: str) -> None:
        """Keep the warnings."""
        self.messages.append(message)

    def on_frame(self, event) -> None:
        """Count the frame."""
        super().on_frame(event)
        if len(self.frames) == self.kill_at:
            os.kill(find_workers()[0], signal.SIGKILL)


@pytest.mark.parametrize("kill_at", list_cases([-1, 5], [5]))
def test_two_workers_give_the_ledger_and_findings_of_none_even_if_one_is_killed(
    plant: Path, kill_at: int
) -> None:
    records, alone, _ = replay(plant, 0)
    others, watched, events = replay(plant, 2, kill_at=kill_at)
    assert others == records
    # a frame that nothing follows is measured early, so the findings come in other groups
    assert sorted(map(repr, watched.findings)) == sorted(map(repr, alone.findings))
    assert watched.messages == alone.messages
    assert [event.frames.frame for event in watched.frames] == [event.frames.frame for event in alone.frames]
    assert len(events) == (kill_at > 0)
    assert all("ended by signal 9; another one takes it" in text for text in events)


def test_images_that_fail_their_checks_are_left_out_with_workers_as_without(plant: Path) -> None:
    """Workers begin to match before the images are checked: a fault that begins or ends, or is one frame's alone."""
    camera = sorted(path for path in (plant / "moving").glob("cam*"))[1]
    images = sorted(camera.glob("*.png"))
    for path in images[2:5]:
        write_image(path, np.zeros_like(read_image(path)))
    shutil.copy(images[6], images[7])
    records, alone, _ = replay(plant, 0)
    others, watched, _ = replay(plant, 2)
    assert others == records
    assert sorted(map(repr, watched.findings)) == sorted(map(repr, alone.findings))
    assert watched.messages == alone.messages
    faults = [one.check for one in watched.findings if one.is_fault and one.subject == camera.name]
    assert {"lens_covered", "frozen_image"} <= set(faults)


def stop_belt(plant: Path, after: int, rest: int) -> None:
    """Have the recorded belt stand for ``rest`` frames, each with noise of its own, after its first ones."""
    table = plant / "moving" / "encoder.csv"
    header, *rows = table.read_text().splitlines()
    times = [float(row.split(",")[1]) for row in rows]
    step_s, position = times[1] - times[0], rows[after].split(",")[2]
    names = [row.split(",")[0] for row in rows]
    shown = [*names[: after + 1], *[names[after]] * rest, *names[after + 1 :]]
    positions = [row.split(",")[2] for row in rows]
    positions[after + 1 : after + 1] = [position] * rest
    for camera in (path for path in (plant / "moving").iterdir() if path.is_dir()):
        images = {name: read_image(camera / f"{name}.png") for name in names}
        for number, name in enumerate(shown):
            rng, image = np.random.default_rng([number, len(camera.name), ord(camera.name[-1])]), images[name]
            noisy = image + (0.7 if number > after and names[after] == name else 0.0) * rng.normal(
                0, 1, image.shape
            )
            write_image(camera / f"{number:03d}.png", np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    lines = [f"{k:03d},{times[0] + k * step_s:.6f},{place}" for k, place in enumerate(positions)]
    table.write_text("\n".join([header, *lines]) + "\n")


def test_a_belt_at_rest_is_matched_once_a_second_with_workers_as_without(plant: Path) -> None:
    stop_belt(plant, 6, 40)
    with (plant / "project.toml").open("a") as project:
        project.write("[health]\nlearning_frames = 3\n")
    records, alone, _ = replay(plant, 0)
    others, watched, _ = replay(plant, 2)
    assert others == records
    assert sorted(map(repr, watched.findings)) == sorted(map(repr, alone.findings))
    assert [event.is_repeat for event in watched.frames] == [event.is_repeat for event in alone.frames]
    last = watched.frames[-1]
    assert (last.done + last.repeated, last.dropped) == (len(watched.frames), 0)
    # not before a direction is assumed, after eight frames without a motion, nor in the 2 s after that doubt
    assert last.repeated == pytest.approx((40 - 2 - 16) * 7 / 8, abs=2)
    resting = watched.frames[12:44]
    assert max(abs(event.speed_mm_s) for event in resting) < 1.0
    assert min(event.coverage for event in resting) > 0.5


OF_A_FRAME = ((meter, "prepare_depth"), (belt_monitor, "measure_bare_belt"), (image_monitor, "sample_images"))


def test_workers_measure_what_needs_nothing_of_the_sequence(
    plant: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here: list[str] = []
    for module, name in (*OF_A_FRAME, (blocks, "fill_holes")):
        measure = getattr(module, name)

        def call(*given, m=measure, n=name, **named):
            here.append(n)
            return m(*given, **named)

        monkeypatch.setattr(module, name, call)
    _, watched, _ = replay(plant, 0)
    frames = len(watched.frames)
    assert [here.count(name) for _, name in OF_A_FRAME] == [frames] * len(OF_A_FRAME)
    assert here.count("fill_holes")
    here.clear()
    replay(plant, 2)
    assert here == []


def test_as_many_workers_as_cores_and_none_for_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BELTSCAPE_CORES", "1")
    assert (count_workers("auto"), count_workers(3), count_workers(0)) == (0, 3, 0)


def test_few_workers_open_one_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("beltscape.pipeline.reconstructing.match_ahead.count_usable_cores", lambda: 16)
    for name, is_there, expected in (("", True, 4), ("cuda", True, 4), ("native", True, 16), ("", False, 16)):
        monkeypatch.setenv("BELTSCAPE_KERNELS", name)
        for part in ("driver", "library"):
            monkeypatch.setattr(
                f"beltscape.kernels.cuda.cuda_device.is_{part}_present", lambda is_there=is_there: is_there
            )
        assert count_workers("auto") == expected
        assert count_workers(9) == 9
