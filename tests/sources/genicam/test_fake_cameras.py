"""The camera source with Aravis's simulated cameras, which are killed and restarted."""

from __future__ import annotations

import json
import threading
import time
from argparse import Namespace
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import pytest

from beltscape.cli.commands import cameras
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.sources.fake_genicam.simulated_cameras import SimulatedCameras
from beltscape.sources.genicam.health import START_IMAGES
from beltscape.sources.genicam.settings import CamerasSettings
from beltscape.sources.genicam.source import open_cameras
from tests.optional import require

NAMES = tuple(f"cam{i}" for i in range(5))
SIZE = (64, 48)
ROUND = 25


def picture(camera: int, number: int) -> np.ndarray:
    """Noise of one camera; its first row encodes the number."""
    image = np.random.default_rng(camera).integers(0, 200, SIZE[::-1], dtype=np.uint8)
    image[0] = 10 * number
    return image


PICTURES = {name: [picture(i, k) for k in range(ROUND)] for i, name in enumerate(NAMES)}


class Collected:
    """Frame sets with the moment they came, fetched by a thread of its own."""

    def __init__(self, source) -> None:
        self.sets: list[tuple[float, FrameSet]] = []
        self._thread = threading.Thread(target=self._fetch, args=(source,))
        self._thread.start()

    def _fetch(self, source) -> None:
        for one in source:
            self.sets.append((time.monotonic(), one))

    def since(self, moment: float) -> list[tuple[float, FrameSet]]:
        return [one for one in self.sets if one[0] >= moment]

    def wait(self, fits, seconds: float) -> float:
        """Seconds until a set that came from now on fits."""
        begin = time.monotonic()
        while time.monotonic() - begin < seconds:
            for moment, one in self.since(begin):
                if fits(one):
                    return moment - begin
            time.sleep(0.02)
        pytest.fail(f"not within {seconds} s; last: {[sorted(s.images) for _, s in self.sets[-5:]]}")

    def join(self) -> None:
        self._thread.join(5)
        assert not self._thread.is_alive()


@contextmanager
def running(settings: dict, core: str, sizes_px):
    source = open_cameras(CamerasSettings.model_validate(settings), core, sizes_px)
    collected = Collected(source)
    try:
        yield source, collected
    finally:
        source.close()
        collected.join()


def settings_of(bench: SimulatedCameras, **more) -> dict:
    return {
        "devices": bench.devices,
        "frames_per_s": 10,
        "exposure_us": 1000,
        "allowed_skew_ms": 15,  # a busy machine
        "packet_size": 9000,
        "encoder": {"feature": "TestRegister", "mm_per_count": 0.5},
        **more,
    }


def whole(one: FrameSet) -> bool:
    return len(one.images) == 5


def without(name: str):
    return lambda one: set(one.images) == set(NAMES) - {name}


def assert_true(sets: list[FrameSet]) -> None:
    """Byte for byte what was shown, never mixed, names, times and positions growing."""
    for one in sets:
        numbers = {name: int(image[0, 0]) // 10 for name, image in one.images.items()}
        assert len(set(numbers.values())) == 1, numbers
        for name, image in one.images.items():
            np.testing.assert_array_equal(image, PICTURES[name][numbers[name]])
        if "cam0" in one.images:
            assert one.position_mm is not None
            # a feature is read after the image: on a busy machine it may already be a later one's
            assert (round(one.position_mm / 0.5) // 100 - numbers["cam0"]) % ROUND <= 2
    names = [one.frame for one in sets]
    assert all(len(name) == 8 for name in names)
    assert names == sorted(set(names))
    times = [require(one.time_ns) for one in sets]
    assert all(b > a for a, b in pairwise(times))
    positions = [one.position_mm for one in sets if one.position_mm is not None]
    assert all(b >= a for a, b in pairwise(positions))


def longest_gap(collected: Collected, begin: float, end: float) -> float:
    moments = [begin, *(m for m, _ in collected.sets if begin < m < end), end]
    return max(b - a for a, b in pairwise(moments))


def test_five_cameras_are_matched_survive_a_loss_and_rejoin(fake_network, tmp_path):
    counts = [100 * k for k in range(ROUND)]
    bench = SimulatedCameras(tmp_path / "bench", PICTURES, 10, counts, 100 * ROUND)
    with bench, running(settings_of(bench), "cam0", bench.sizes_px) as (source, collected):
        collected.wait(whole, 10)
        until = time.monotonic() + 10  # a camera that has just been started is waiting, not lost
        while min(c.frames for c in source.health().values()) < START_IMAGES and time.monotonic() < until:
            time.sleep(0.05)
        assert {c.state for c in source.health().values()} == {"ok"}

        for name in ("cam3", "cam0"):  # an auxiliary one, then the core
            killed = time.monotonic()
            bench.kill(name)
            collected.wait(without(name), 1.5)
            time.sleep(1.0)
            assert longest_gap(collected, killed, time.monotonic()) < 1.0
            lost = source.health()[name]
            assert lost.state == "lost"
            assert "power, cable" in lost.message
            bench.start(name)
            assert collected.wait(lambda one, name=name: name in one.images, 8) < 5
            collected.wait(whole, 10)  # a busy machine may give many that lack another one
            assert source.health()[name].state == "ok"
    sets = [one for _, one in collected.sets]
    assert_true(sets)
    assert sum(map(whole, sets)) > 3
    assert len(sets) > 30


def test_formats_and_sizes_as_set(fake_network, tmp_path):
    rng = np.random.default_rng(5)
    mosaic = np.zeros((48, 64), np.uint8)
    mosaic[0::2, 0::2], mosaic[1::2, 1::2] = 200, 50  # red, blue; green is 0
    deep = rng.integers(0, 65536, (32, 40), dtype=np.uint16)
    colour = rng.integers(0, 256, (24, 32, 3), dtype=np.uint8)
    bench = SimulatedCameras(tmp_path / "bench", {"cam0": [mosaic], "cam1": [deep], "cam2": [colour]}, 10)
    own = {
        "cam0": {"pixel_format": "BayerRG8"},
        "cam1": {"pixel_format": "Mono16"},
        "cam2": {"pixel_format": "RGB8"},
    }
    settings = settings_of(bench, own=own, trigger="free", clocks="ptp", encoder=None, allowed_skew_ms=35)
    with bench, running(settings, "cam0", bench.sizes_px) as (_, collected):
        collected.wait(lambda one: len(one.images) == 3, 10)
    images = next(one.images for _, one in reversed(collected.sets) if len(one.images) == 3)
    np.testing.assert_array_equal(images["cam1"], deep)
    np.testing.assert_array_equal(images["cam2"], colour)
    assert images["cam0"].shape == (48, 64, 3)
    assert tuple(images["cam0"][20, 20]) == (200, 0, 50)


def test_unsupported_camera_is_reported_and_the_others_continue(fake_network, tmp_path, monkeypatch):
    monkeypatch.setattr("beltscape.sources.genicam.health.START_GRACE_S", 3.0)
    bench = SimulatedCameras(tmp_path / "bench", {name: PICTURES[name] for name in ("cam0", "cam1")}, 10)
    devices = {"cam0": bench.devices["cam0"], "cam1": "cam1", "cam2": "GV99"}  # two by serial number
    settings = settings_of(bench, devices=devices, own={"cam0": {"gain_db": -20}}, encoder=None)
    with bench, running(settings, "cam1", {"cam1": SIZE}) as (source, collected):
        collected.wait(lambda one: set(one.images) == {"cam1"}, 10)
        until = time.monotonic() + 20
        while (
            "waiting" in {source.health()[name].state for name in ("cam0", "cam2")}
            and time.monotonic() < until
        ):
            time.sleep(0.05)
        health = source.health()
    assert health["cam0"].state == "lost"
    assert "cam0: gain_db -20 is outside the camera's" in health["cam0"].message
    assert health["cam2"].state == "lost"
    assert "no camera GV99 answers; there are: " in health["cam2"].message
    assert "(127.0.0.12)" in health["cam2"].message
    assert health["cam1"].state == "ok"


def test_simulated_cameras_are_found_and_checked(tmp_path, fake_network):
    project = tmp_path / "project.toml"
    project.write_text(
        '[cameras]\npixel_format = "Mono12p"\ntrigger = "line"\ntrigger_line = "Line0"\n'
        '[cameras.devices]\ncam0 = "127.0.0.11"\ncam1 = "cam1"\n[cameras.own.cam1]\npixel_format = "Mono8"\n'
    )
    dark = [np.zeros((4, 4), np.uint8)]
    with SimulatedCameras(tmp_path / "bench", {"cam0": dark, "cam1": dark}, 10):
        result = cameras.run(Namespace(check=project), Silent())
    assert [(one["address"], one["serial"]) for one in result["cameras"]] == [
        ("127.0.0.11", "cam0"),
        ("127.0.0.12", "cam1"),
    ]
    assert "Mono8" in result["cameras"][0]["formats"]
    assert "the camera offers no Mono12p; it has " in result["check"]["cam0"]
    assert result["check"]["cam1"] == ""
    json.dumps(result)
    assert "127.0.0.12" in cameras.summary(result)
