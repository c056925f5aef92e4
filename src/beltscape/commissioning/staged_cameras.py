"""Cameras that are not there: a folder of captures shown as a carried board, and a simulated board that follows.

Both wait between two frame sets until the last one was looked at, so that a slow machine skips nothing, and time is
counted in frame sets. The simulated board is carried by a hand that follows the dashed outline of the page: it knows
where the outline is drawn, and nothing of the calibration.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from beltscape.calibration.detection.corners import Corners
from beltscape.calibration.network.resection import fit_board_pose
from beltscape.core.errors import CalibrationError, InputError
from beltscape.core.events import CameraHealth
from beltscape.core.frames import FrameSet, Image
from beltscape.core.geometry.pose import Pose, rotation_from_vector
from beltscape.core.geometry.rig import Rig
from beltscape.files.capture import Capture
from beltscape.files.images import read_image
from beltscape.pipeline.calibrating.guidance import draw_ghost, outline_mm
from beltscape.simulate.board_pictures import BoardPictures
from beltscape.sources.folder import find_image_size
from beltscape.target.planar_boards import SquareBoard

STILL_FRAMES, MOVING_FRAMES = 3, 1
"""Frame sets of a view at rest, and of the motion towards it."""
PERIOD_S = 0.25
"""Time from one frame set of a carried board to the next: slow enough for the detection of five cameras."""
_BLUR = 0.04
"""Length of the motion blur over the image's width."""
_MOST_HOLDS = 60
"""Poses after which the hand is tired: three times those that are usually enough."""
_SWAY_MM, _SWAY_RAD = 45.0, 0.2
"""σ of how far the hand moves on where the outline stays though the view is not taken."""
Outlines = Mapping[str, list[list[float]]]
"""Camera → (n, 2) px, as `draw_ghost` gives them."""


class StagedCameras(ABC):
    """Live source without cameras, which waits until its last frame set was looked at."""

    def __init__(self, cameras: tuple[str, ...]) -> None:
        self._cameras, self._period_s = cameras, PERIOD_S
        self._closed = threading.Event()
        self.is_exhausted = False
        """True when there is nothing new to show."""

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras."""
        return self._cameras

    @abstractmethod
    def follow(self, outlines: Outlines) -> None:
        """Carry the board to a dashed outline, where it can be carried."""

    @abstractmethod
    def __iter__(self) -> Iterator[FrameSet]:
        """Yield frame sets until the source is closed."""

    def health(self) -> Mapping[str, CameraHealth]:
        """Return that all cameras are well."""
        rate = 1 / self._period_s if self._period_s else float("nan")
        return {name: CameraHealth(name, "ok", 0, 0, rate, float("nan"), "") for name in self.cameras}

    def close(self) -> None:
        """Stop before the next frame set."""
        self._closed.set()

    def _wait(self) -> bool:
        """Wait for the next frame set; return whether the source was closed."""
        return self._closed.wait(self._period_s)


class CarriedBoard(StagedCameras):
    """Shows the views of a recorded capture as if the board were carried about, again and again.

    An image that cannot be read, or has not the size of its camera's others, is left out and named.
    """

    def __init__(self, capture: Capture) -> None:
        super().__init__(capture.cameras)
        self._capture = capture
        self._left_out: dict[str, dict[Path, str]] = {name: {} for name in capture.cameras}

    @cached_property
    def _sizes_px(self) -> Mapping[str, tuple[int, int] | None]:
        """(width, height) of most of the first images of each camera; None where none can be read."""
        return {name: find_image_size(own.values()) for name, own in self._capture.files.items()}

    def follow(self, outlines: Outlines) -> None:
        """Go on with the recorded views; they follow no outline."""

    def __iter__(self) -> Iterator[FrameSet]:
        number = 0
        while not self._closed.is_set():
            for frame in self._capture.frames:
                images = self._read(frame)
                moving = {name: _blur(image) for name, image in images.items()}
                for shown in [moving] * MOVING_FRAMES + [images] * STILL_FRAMES:
                    if self._wait():
                        return
                    if shown:
                        yield FrameSet(f"{number:06d}", shown, time.monotonic_ns(), recorded=frame)
                        number += 1
            self.is_exhausted = True

    def health(self) -> Mapping[str, CameraHealth]:
        """Return the cameras of which images were left out as lost, with the first one's line."""
        states = super().health()
        return {name: self._describe_left_out(own) for name, own in states.items()}

    def _describe_left_out(self, health: CameraHealth) -> CameraHealth:
        lines = list(self._left_out[health.name].values())
        if not lines:
            return health
        more = f" ({len(lines) - 1} more)" if len(lines) > 1 else ""
        return replace(health, state="lost", missed=len(lines), message=f"{lines[0]}{more}")

    def list_left_out(self) -> list[str]:
        """Read all images; return one line for each that is left out, with its file and what is wrong."""
        for frame in self._capture.frames:
            self._read(frame)
        return [line for own in self._left_out.values() for line in own.values()]

    def _read(self, frame: str) -> dict[str, Image]:
        """Return the usable images of an instant by camera."""
        files = self._capture.files
        images = {name: self._read_image(name, own[frame]) for name, own in files.items() if frame in own}
        return {name: image for name, image in images.items() if image is not None}

    def _read_image(self, camera: str, path: Path) -> Image | None:
        try:
            image = read_image(path)
        except InputError as error:
            self._left_out[camera][path] = f"{error}; it is left out"
            return None
        size_px, own_px = image.shape[1::-1], self._sizes_px[camera]
        if own_px is not None and size_px != own_px:
            self._left_out[camera][path] = (
                f"{path}: {size_px[0]}×{size_px[1]} px, but {camera}'s other images have {own_px[0]}×{own_px[1]}; "
                "it is left out: record it again, or remove it"
            )
            return None
        return image


class SimulatedBoard(StagedCameras):
    """Shows a board that is carried to the dashed outline, and held there until the outline moves on."""

    def __init__(self, rig: Rig, board: SquareBoard, backgrounds: Mapping[str, Image]) -> None:
        """``rig`` is the true one; ``backgrounds``: (H, W) uint8 by camera."""
        super().__init__(tuple(rig.cameras))
        self._rig, self._board = rig, board
        self._pictures = BoardPictures(rig, board, backgrounds)
        self._outline_mm = outline_mm(board)
        self._rng = np.random.default_rng(0)
        self._outlines: Outlines = {}
        self.holds = 0
        """Poses at which the board was held."""
        self.shown = 0
        """Frame sets shown."""

    def follow(self, outlines: Outlines) -> None:
        """Carry the board to where this outline is drawn, as soon as the view before is done with."""
        self._outlines = outlines

    def __iter__(self) -> Iterator[FrameSet]:
        before = self._sway(self._find_pose(self._draw_start()))
        followed: Outlines = {}
        while not self._closed.is_set():
            outlines = self._outlines or self._draw_start()
            pose = self._find_pose(outlines)
            if outlines == followed:
                pose = self._sway(pose)
            for shown in self._show(before, pose):
                if self._wait():
                    return
                yield FrameSet(f"{self.shown:06d}", shown, time.monotonic_ns())
                self.shown += 1
                if self._outlines and self._outlines != outlines:
                    break  # the view was taken, and the outline is elsewhere
            before, followed = pose, outlines
            self.holds += 1
            self.is_exhausted = self.holds >= _MOST_HOLDS

    def _show(self, before: Pose, pose: Pose) -> Iterator[dict[str, Image]]:
        """Yield the pictures of the way to a pose, and of the rest there."""
        for step in range(MOVING_FRAMES):
            share = (step + 1) / (MOVING_FRAMES + 1)
            between = Pose(pose.rotation, (1 - share) * before.translation_mm + share * pose.translation_mm)
            seen = self._pictures.render(between, self.shown)
            yield {name: _blur(image) for name, image in seen.items()}
        for _ in range(STILL_FRAMES):
            yield self._pictures.render(pose, self.shown)

    def _draw_start(self) -> Outlines:
        sizes = {name: lens.size_px for name, lens in self._rig.cameras.items()}
        return draw_ghost(self._board, sizes, self._rig.core, None, self.holds)

    def _find_pose(self, outlines: Outlines) -> Pose:
        """Return where the board fills the outlines; where none fits, that of a starting pose."""
        numbers = np.arange(len(self._outline_mm))
        views = {
            name: Corners(numbers, np.asarray(own, np.float64))
            for name, own in outlines.items()
            if name in self._rig.cameras
        }
        try:
            return fit_board_pose(self._rig, views, self._outline_mm)
        except (CalibrationError, np.linalg.LinAlgError, ValueError):
            return self._find_pose(self._draw_start())

    def _sway(self, pose: Pose) -> Pose:
        """Return a pose nearby: what a hand does where the view is known, or the board is too oblique."""
        turn = rotation_from_vector(self._rng.normal(0.0, _SWAY_RAD, 3))
        middle = self._outline_mm.mean(axis=0)
        moved = pose.apply(middle) + self._rng.normal(0.0, _SWAY_MM, 3)
        return Pose.placing(turn @ pose.rotation, middle, moved)


def _blur(image: Image) -> Image:
    width = max(3, round(_BLUR * image.shape[1]))
    return np.asarray(cv2.blur(image, (width, 1)), image.dtype)
