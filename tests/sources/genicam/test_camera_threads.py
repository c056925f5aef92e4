"""The threads of a camera, with devices that the test controls."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.core.frames import FrameSet
from beltscape.sources.genicam.camera import TriggerPace
from beltscape.sources.genicam.device import RawImage
from beltscape.sources.genicam.health import find_brightness_fault
from beltscape.sources.genicam.settings import CamerasSettings
from beltscape.sources.genicam.source import GenicamSource
from tests.protocols.broker import wait_until

MONO8 = 0x01080001


class Steered:
    """A camera that answers a trigger at once, until it is set to dead: then its calls hang."""

    def __init__(self, size=(8, 6), level: int = 100) -> None:
        self.size, self.level = size, level
        self.dead = False
        self.is_lost = False
        self.broken = 0
        self.frames = 0
        self.closed = threading.Event()
        self.exposures_us: list[float] = []
        self._images: list[RawImage] = []
        self._came = threading.Condition()

    def trigger(self) -> bool:
        if self.dead:
            return not self.closed.wait(2.0)
        self.frames += 1
        now = time.monotonic_ns()
        data = np.full(self.size[::-1], self.level, np.uint8).tobytes()
        with self._came:
            self._images.append(RawImage(data, MONO8, self.size, self.frames, now + 10**15, now, self.frames))
            self._came.notify()
        return True

    def receive(self, seconds: float) -> RawImage | None:
        with self._came:
            self._came.wait_for(lambda: self._images, seconds)
            return self._images.pop(0) if self._images else None

    def set_exposure(self, exposure_us: float) -> bool:
        self.exposures_us.append(exposure_us)
        return True

    def close(self) -> None:
        self.closed.set()


def source_of(devices: dict[str, list], **more) -> GenicamSource:
    """Each opening of a camera gives its next device, or raises what is in its place."""
    settings = CamerasSettings(
        devices={name: name for name in devices},
        frames_per_s=25,
        allowed_skew_ms=15,
        frame_timeout_ms=150,
        **more,
    )

    def opener(name: str):
        given = devices[name].pop(0) if len(devices[name]) > 1 else devices[name][0]
        if isinstance(given, Exception):
            raise given
        return given

    return GenicamSource(settings, next(iter(devices)), dict.fromkeys(devices, (8, 6)), opener)


def fetch(source: GenicamSource, enough, seconds: float = 6.0) -> list[tuple[float, FrameSet]]:
    out: list[tuple[float, FrameSet]] = []
    begin = time.monotonic()
    for one in source:
        out.append((time.monotonic(), one))
        if enough(one) or time.monotonic() - begin > seconds:
            return out
    return out


def test_trigger_of_a_lost_camera_delays_no_other(monkeypatch):
    monkeypatch.setattr("beltscape.sources.genicam.health.START_GRACE_S", 0.0)
    a, b, again = Steered(), Steered(), Steered()
    source = source_of({"cam0": [a], "cam1": [b, again]})
    fetch(source, lambda one: len(one.images) == 2)
    b.dead = True
    died = time.monotonic()
    sets = fetch(source, lambda _: time.monotonic() - died > 0.8)
    moments = [died, *(moment for moment, _ in sets)]
    assert max(np.diff(moments)) < 0.6
    assert source.health()["cam1"].state == "lost"
    assert source.health()["cam0"].state == "ok"
    fetch(source, lambda one: again.frames > 0 and len(one.images) == 2)
    assert b.closed.is_set()
    assert source.health()["cam1"].state == "ok"
    source.close()


def test_camera_that_cannot_be_opened_is_retried_and_reported(monkeypatch):
    monkeypatch.setattr("beltscape.sources.genicam.source.START_S", 0.2)
    monkeypatch.setattr("beltscape.sources.genicam.health.START_GRACE_S", 0.0)
    trouble = [InputError("cam1 (10.0.0.7): no answer")] * 5
    source = source_of(
        {"cam0": [Steered()], "cam1": [*trouble, RuntimeError("driver broke\nline two"), Steered()]}
    )
    one = fetch(source, lambda _: True)[0][1]
    assert set(one.images) == {"cam0"}
    assert source.health()["cam1"].state == "lost"
    assert source.health()["cam1"].message.endswith("programs that use it (cam1 (10.0.0.7): no answer)")
    fetch(source, lambda one: len(one.images) == 2)
    source.close()


def test_unusable_images_are_reported():
    source = source_of({"cam0": [Steered()], "cam1": [Steered(size=(4, 4))], "cam2": [Steered(level=255)]})
    fetch(source, lambda one: set(one.images) == {"cam0", "cam2"} and source.health()["cam1"].message != "")
    health = source.health()
    assert (health["cam1"].state, health["cam2"].state) == ("unusable", "unusable")
    assert "4×4 px, the rig's 8×6" in health["cam1"].message
    assert "100 % of the pixels are saturated; lower exposure_us" in health["cam2"].message
    assert health["cam0"].state == "ok"
    source.close()


def test_unfetched_frame_sets_are_dropped_oldest_first():
    source = source_of({"cam0": [Steered()]})
    first = fetch(source, lambda _: True)[0][1]
    wait_until(lambda: source.overrun > 3, 20)
    after = fetch(source, lambda _: True)[0][1]
    assert source.overrun > 0
    assert int(after.frame) - int(first.frame) == source.overrun + 1
    source.close()


def test_frame_sets_of_before_the_first_fetch_are_not_measured_late():
    source = source_of({"cam0": [Steered()]})
    time.sleep(0.8)
    waited = len(source._ready)
    first = fetch(source, lambda _: True)[0][1]
    assert waited > 3
    assert int(first.frame) >= waited
    source.close()


def test_a_camera_that_is_still_held_by_a_killed_program_is_no_loss():
    held = [InputError("cam1 (10.0.0.7): access denied")] * 4
    source = source_of({"cam0": [Steered()], "cam1": [*held, Steered()]})
    states = set()
    until = time.monotonic() + 10
    while source.health()["cam1"].state != "ok" and time.monotonic() < until:
        states.add(source.health()["cam1"].state)
        time.sleep(0.02)
    assert states == {"waiting"}
    assert source.health()["cam1"].state == "ok"
    source.close()


def test_closing_ends_the_iteration_with_a_lost_camera():
    dead = Steered()
    dead.dead = True
    source = source_of({"cam0": [Steered()], "cam1": [dead]})
    ended = threading.Event()
    threading.Thread(target=lambda: (list(source), ended.set())).start()
    time.sleep(0.2)
    source.close()
    assert ended.wait(1)


def test_all_threads_have_the_same_instants():
    pace = TriggerPace(100.0, 0.1)
    assert pace.after(100.0) == pytest.approx(100.1)
    assert pace.after(100.349) == pytest.approx(100.4)
    assert pace.after(99.95) == pytest.approx(100.0)


def test_brightness_faults_are_found():
    assert find_brightness_fault(np.full((40, 40), 255, np.uint8)).startswith("overexposed: 100 %")
    assert find_brightness_fault(np.full((40, 40), 900, np.uint16)).startswith(
        "dark: the brightest pixels reach 1.4 %"
    )
    assert find_brightness_fault(np.full((40, 40, 3), 90, np.uint8)) == ""
