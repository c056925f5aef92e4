"""Dirt on a window: found at its place, in the camera that has it."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.findings import Finding
from beltscape.health.images.monitor import ImageMonitor
from beltscape.health.settings import HealthSettings
from tests.health.images.speckled_belt import SIZE, Levels, make_frame, make_rig
from tests.thorough import list_cases

DEPTH_MM = 1e6
"""So far away that all drawn cameras see the same picture."""
CLEAN = 14


def make_depth() -> DepthMap:
    shape = SIZE[::-1]
    ones = np.ones(shape, np.float32)
    return DepthMap(DEPTH_MM * ones, ones, np.full(shape, 4, np.uint8), ones)


def soil(camera: str, opacity: float) -> Callable[[str, Levels], Levels]:
    def change(name: str, light: Levels) -> Levels:
        if name != camera:
            return light
        dirty = light.copy()
        dirty[100:180, 200:300] *= 1 - opacity
        return dirty

    return change


@cache
def watch_clean_windows() -> ImageMonitor:
    monitor = ImageMonitor(make_rig(), HealthSettings(learning_frames=5))
    for number in range(CLEAN):
        check = monitor.check_images(make_frame(number))
        assert not any(one.is_fault for one in monitor.check_depth(check, make_depth()))
    return monitor


def follow(camera: str, opacity: float, frames: int) -> list[list[Finding]]:
    """Return the faults of frames with dirt, after clean ones."""
    monitor = deepcopy(watch_clean_windows())
    results: list[list[Finding]] = []
    for number in range(CLEAN, CLEAN + frames):
        check = monitor.check_images(make_frame(number, soil(camera, opacity)))
        results.append([one for one in monitor.check_depth(check, make_depth()) if one.is_fault])
    return results


@pytest.mark.parametrize("camera", list_cases(["cam0", "cam2"], ["cam2"]))
def test_opaque_dirt_is_found_within_four_frames_with_its_place(camera: str) -> None:
    results = follow(camera, 0.95, 4)
    (dirt,) = results[-1]

    assert dirt.subject == camera
    assert dirt.effect == "degraded"
    assert dirt.value == pytest.approx(100 * 80 * 100 / (SIZE[0] * SIZE[1]), rel=0.4)
    assert dirt.place == pytest.approx((0.5, 0.3125, 0.75, 0.5625), abs=0.04)


def test_faint_dirt_is_found_in_time() -> None:
    results = follow("cam1", 0.35, 40)

    assert {one.subject for one in results[-1]} == {"cam1"}


def test_clean_windows_have_no_dirt() -> None:
    assert not any(follow("cam0", 0.0, 10))


def test_frozen_camera_is_not_accused_of_dirt() -> None:
    monitor = deepcopy(watch_clean_windows())
    frozen = make_frame(CLEAN).images["cam2"]
    for number in range(CLEAN, CLEAN + 8):
        frames = make_frame(number)
        frames = replace(frames, images={**frames.images, "cam2": frozen})
        check = monitor.check_images(frames)
        assert not any(one.is_fault for one in monitor.check_depth(check, make_depth()))
