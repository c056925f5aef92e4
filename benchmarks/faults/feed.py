"""The source of a row: the round capture again and again, with a fault from one frame on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any
from zlib import crc32

import numpy as np

from beltscape.core.events import CameraHealth
from beltscape.core.frames import FrameSet, Image
from beltscape.files.images import read_image
from beltscape.simulate.faults.settings import Faults, apply_to_images
from faults.capture import FRAMES_PER_S, RoundCapture
from faults.case import Case

_LOST_S = 1.5
"""Time without an image after which the camera source calls a camera lost."""
_STANDING_FRAMES = 5
"""Frames for which a belt stands before it rolls back, and before it runs on. Chosen: 0.6 s."""
_NOISE = 1.5
"""Noise of images of a belt that is seen again, grey values of 255: that of the rows with repeated images."""


def find_shown_frame(capture: RoundCapture, case: Case, onset: int, number: int) -> int:
    """Return the frame of the endless belt that is seen in a delivered one: another where it stood or rolled back."""
    since = number - onset
    if case.rests_s:
        stopped, rests = onset - round(case.rests_s * FRAMES_PER_S), case.rests_s + case.stays_s
        return min(number, stopped) + max(number - stopped - round(rests * FRAMES_PER_S), 0)
    back = round(case.rolls_back_mm * capture.frames / capture.round_mm)
    if since < 0 or back == 0:
        return number
    rolled = min(max(since - _STANDING_FRAMES, 0), back)
    run_on = max(since - 2 * _STANDING_FRAMES - back, 0)
    return onset - rolled + run_on + (back if onset < back else 0)


class Feed:
    """A `LiveSource` of the capture with the fault of a row; it hands out frames by number."""

    def __init__(self, capture: RoundCapture, case: Case, onset: int, count: int) -> None:
        self._capture, self._case, self._count = capture, case, count
        self.onset = onset
        self.faults = make_faults(case.faults, onset)
        self._sound = lru_cache(maxsize=2 * capture.frames)(capture.images)
        self._last_s = dict.fromkeys(capture.rig.cameras, 0.0)
        self._now_s = 0.0
        shown = [find_shown_frame(capture, case, onset, number) for number in range(count)]
        self._shown = shown
        position = np.array([capture.position_mm(frame) for frame in shown])
        for fault in self.faults.encoder:
            position = fault.apply(position)
        self._position_mm = position
        path = f"rendered/{case.name.replace(' ', '_').replace('/', '_')}"
        self._anew = self.cameras if case.rendered == "*" else (case.rendered,) if case.rendered else ()
        """The cameras whose images are rendered anew."""
        self._rendered = capture.render(path, self._anew, _drop_last(case.faults)) if self._anew else None
        self._end = find_end(case.faults, onset) if self._anew else None
        """The first frame without the fault in the images that are rendered anew; None: it remains."""
        self._every = (
            1 if case.step_mm is None else max(1, round(case.step_mm * capture.frames / capture.round_mm))
        )
        """From the fault on only every n-th frame set is delivered."""

    @property
    def cameras(self) -> tuple[str, ...]:
        """Return the names of the cameras."""
        return tuple(self._capture.rig.cameras)

    def __iter__(self) -> Iterator[FrameSet]:
        return (
            self.frame(number)
            for number in range(self._count)
            if number < self.onset or (number - self.onset) % self._every == 0
        )

    def frame(self, number: int) -> FrameSet:
        """Return a frame set as the plant with its fault delivers it."""
        frames = replace(self._sound(self._shown[number]), time_ns=round(number / FRAMES_PER_S * 1e9))
        sources = {name: self._shown[source] for name, source in self._list_source_frames(number).items()}
        images = {
            name: self._sound(sources[name]).images[name]
            for name in self.cameras
            if all(fault.delivers(name, number) for fault in self.faults.missing_frames)
        }
        images = {
            name: self._add_noise(image, name, number) if sources[name] != number else image
            for name, image in images.items()
        }
        is_anew = number >= self.onset and (self._end is None or number < self._end)
        if self._rendered is not None and is_anew:
            shown = self._shown[number]
            name = self._capture.truth["frames"][shown % self._capture.frames]["frame"]
            anew = {camera: read_image(self._rendered / camera / f"{name}.png") for camera in self._anew}
            seen_again = shown != number
            images |= {
                camera: self._add_noise(image, camera, number) if seen_again else image
                for camera, image in anew.items()
            }
        reading = float(self._position_mm[number])
        position = reading if np.isfinite(reading) else None
        delivered = replace(frames, frame=f"{number:05d}", images=images, position_mm=position)
        self._now_s = number / FRAMES_PER_S
        self._last_s |= dict.fromkeys(images, self._now_s)
        height = self._capture.scenario.rig.height_mm
        if self._case.rendered and is_anew:
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

    def _add_noise(self, image: Image, camera: str, number: int) -> Image:
        """Return a repeated image with the noise that its fault adds, or that a camera adds to a belt seen again."""
        own = _NOISE if self._case.rolls_back_mm or self._case.rests_s else 0.0
        sigma = max((fault.noise for fault in self.faults.repeated_images), default=own)
        if sigma == 0:
            return image
        rng = np.random.default_rng([crc32(camera.encode()), number])
        noisy = image + sigma * rng.standard_normal(image.shape, dtype=np.float32)
        return np.clip(np.rint(noisy), 0, np.iinfo(image.dtype).max).astype(image.dtype)

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


def _drop_last(described: Mapping[str, Any]) -> dict[str, Any]:
    """Return faults that remain: they are rendered in every frame of the round."""
    return {
        name: [{key: value for key, value in one.items() if key != "last"} for one in many]
        for name, many in described.items()
    }


def find_end(described: Mapping[str, Any], onset: int) -> int | None:
    """Return the first frame after the faults; None where one remains."""
    last = [one.get("last") for many in described.values() for one in many]
    return None if not last or None in last else onset + 1 + max(last)


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
