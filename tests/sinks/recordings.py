"""Frame sets to record, and what a recording of them holds."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from beltscape.core.frames import FrameSet
from beltscape.files.capture import read_capture
from beltscape.files.encoder_csv import read_encoder
from beltscape.files.images import read_image
from beltscape.sinks.recorder import Recorder
from beltscape.sinks.settings import RecordingSettings

CAMERAS = ("cam0", "cam1")


def settings(**values: Any) -> RecordingSettings:
    defaults: dict[str, Any] = {"free_gib": 0, "queue": 1000}
    return RecordingSettings(**(defaults | values))


def frames(number: int, *, position_mm: float | None = None) -> FrameSet:
    rng = np.random.default_rng(number)
    images = {name: rng.integers(0, 256, (40, 50), dtype=np.uint8) for name in CAMERAS}
    return FrameSet(
        f"{number:06d}", images, number * 200_000_000, number * 10.0 if position_mm is None else position_mm
    )


def settled(recorder: Recorder) -> None:
    """Wait until nothing is left to do."""
    for _ in range(500):
        if not recorder._queue:
            return
        time.sleep(0.01)
    raise AssertionError("the recorder does not come to rest")


def holds(folder, numbers) -> bool:
    """Whether the capture has exactly those frame sets, to the pixel, with their readings."""
    capture = read_capture(folder)
    return (
        capture.frames == tuple(f"{n:06d}" for n in numbers)
        and [(r.frame, r.belt_position_mm) for r in read_encoder(folder / "encoder.csv")]
        == [(f"{n:06d}", n * 10.0) for n in numbers]
        and all(
            np.array_equal(read_image(capture.files[name][f"{n:06d}"]), frames(n).images[name])
            for n in numbers
            for name in CAMERAS
        )
    )
