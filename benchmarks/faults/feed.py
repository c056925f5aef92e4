"""The source of a row: the round capture again and again, with a fault from one frame on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from beltscape.core.frames import FrameSet
from beltscape.core.live.events import CameraHealth
from beltscape.files.rasters.images import read_image
from beltscape.simulate.faults.images import apply_to_images
from beltscape.simulate.faults.settings import Faults
from faults.capture import FRAMES_PER_S, RoundCapture, render_cameras
from faults.case import Case

_LOST_S = 1.5
"""Time without an image after which the camera source calls a camera lost."""


class Feed:
    """A `LiveSource` of the capture with the fault of a row; it hands out frames by number."""

    def __init__(self, capture: RoundCapture, case: Case, onset: int, count: int) -> None:
        self._capture, self._case, self._count = capture, case, count
        self.onset = onset
        self.faults = make_faults(case.faults, onset)
        self._sound = lru_cache(maxsize=2 * capture.frames)(capture.images)
        self._last_s = dict.fromkeys(capture.rig.cameras, 0.0)
        self._now_s = 0.0
        position = np.array([capture.position_mm(number) for number in range(count)])
        for fault in self.faults.encoder:
            position = fault.apply(position)
        self._position_mm = position
        path = capture.folder / "rendered" / case.name.replace(" ", "_").replace("/", "_")
        self._anew = self.cameras if case.rendered == "*" else (case.rendered,) if case.rendered else ()
        """The cameras whose images are rendered anew."""
        self._rendered = render_cameras(capture, str(path), self._anew, case.faults) if self._anew else None

    @property
    def cameras(self) -> tuple[str, ...]:
        """Return the names of the cameras."""
        return tuple(self._capture.rig.cameras)

    def __iter__(self) -> Iterator[FrameSet]:
        return (self.frame(number) for number in range(self._count))

    def frame(self, number: int) -> FrameSet:
        """Return a frame set as the plant with its fault delivers it."""
        frames = self._sound(number)
        sources = self._list_source_frames(number)
        images = {
            name: self._sound(sources[name]).images[name]
            for name in self.cameras
            if all(fault.delivers(name, number) for fault in self.faults.missing_frames)
        }
        if self._rendered is not None and number >= self.onset:
            name = self._capture.truth["frames"][number % self._capture.frames]["frame"]
            images |= {camera: read_image(self._rendered / camera / f"{name}.png") for camera in self._anew}
        reading = float(self._position_mm[number])
        position = reading if np.isfinite(reading) else None
        delivered = replace(frames, frame=f"{number:05d}", images=images, position_mm=position)
        self._now_s = number / FRAMES_PER_S
        self._last_s |= dict.fromkeys(images, self._now_s)
        height = self._capture.scenario.rig.height_mm
        if self._case.rendered:
            return delivered
        return apply_to_images(delivered, self.faults, number, self._capture.rig.cameras, height)

    def health(self) -> Mapping[str, CameraHealth]:
        """Return the state of every camera: lost after a while without images."""
        return {
            name: CameraHealth(name, "lost", 1, 1, 0.0, float("nan"), f"{name}: no image")
            if self._now_s - last_s > _LOST_S
            else CameraHealth(name, "ok", 1, 0, FRAMES_PER_S, 0.0)
            for name, last_s in self._last_s.items()
        }

    def close(self) -> None:
        """End the source; there is nothing to end."""

    def _list_source_frames(self, number: int) -> dict[str, int]:
        """Return the number of the frame that each camera shows."""
        sources = dict.fromkeys(self.cameras, number)
        for repeated in self.faults.repeated_images:
            for name in sources:
                if repeated.camera in ("", name):
                    sources[name] = repeated.source_frame(sources[name])
        for late in self.faults.late_camera:
            sources[late.camera] = late.source_frame(sources[late.camera])
        return sources


def make_faults(described: Mapping[str, Any], onset: int) -> Faults:
    """Return faults that begin in the frame ``onset``."""
    started = {
        name: [{"first": onset, **_shift_last(one, onset)} for one in many]
        for name, many in described.items()
    }
    return Faults.model_validate(started)


def _shift_last(one: Mapping[str, Any], onset: int) -> dict[str, Any]:
    """Return a fault whose ``last`` frame, given after its beginning, counts from the start."""
    return {**one, "last": one["last"] + onset} if "last" in one else dict(one)
