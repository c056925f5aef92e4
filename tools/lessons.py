"""Frames to learn from: simulated captures with truth, and the ways a plant spoils them; for the other tools."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.core.rig import Rig
from beltscape.core.scaling import scale_rig
from beltscape.files.rasters.images import read_image
from beltscape.files.rig_json import read_rig
from beltscape.stereo.multiview.initialisation.depth_range import find_depth_range

Images = dict[str, np.ndarray]
Spoil = Callable[[Images], Images]
ON_FAILURE_MM = (560.0, 800.0)
"""Depth range of captures that show nothing, which are to be learnt from as well."""
EVERY = 3
"""Of the ways of spoiling, each capture takes one in so many, another capture the others."""
HALVED_FROM_PX = 1000
"""Smaller images are not halved as well."""
ONE_SURFACE_MM = 4.0
"""Within so much the depths of four pixels are of one surface."""


@dataclass(frozen=True)
class Lesson:
    """A frame, who looked at it, and what is true."""

    rig: Rig
    names: tuple[str, ...]
    """The auxiliaries."""
    preset: str
    frame: FrameSet
    near_far_mm: tuple[float, float]
    depth_mm: np.ndarray
    label: np.ndarray
    views: np.ndarray
    """How many auxiliaries see a pixel's point."""
    alien: bool
    """The images show nothing, or not the same: what is right is right by chance."""


@dataclass(frozen=True)
class Capture:
    """A simulated frame, and what is true of the core's pixels."""

    rig: Rig
    images: Images
    depth_mm: np.ndarray
    label: np.ndarray
    views: np.ndarray
    """How many auxiliaries see a pixel's point."""

    def lesson(self, names: tuple[str, ...], preset: str, spoil: Spoil) -> Lesson:
        """Seen by these auxiliaries, spoiled in that way."""
        frame = FrameSet("000", spoil({name: self.images[name] for name in (self.rig.core, *names)}))
        try:
            near_far = find_depth_range(self.rig, frame, Silent())
        except ReconstructionError:
            near_far = ON_FAILURE_MM
        return Lesson(
            self.rig, names, preset, frame, near_far, self.depth_mm, self.label, self.views,
            spoil in (strangers, blank),
        )  # fmt: skip

    def halved(self) -> Capture:
        """Every four pixels as one, which knows no depth where the four are not one surface."""
        height, width = (side // 2 for side in self.depth_mm.shape)
        fours = self.depth_mm.reshape(height, 2, width, 2)
        depth = np.where(
            np.ptp(fours, axis=(1, 3)) < ONE_SURFACE_MM, 1 / (1 / fours).mean(axis=(1, 3)), np.nan
        )
        images = {
            name: cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
            for name, image in self.images.items()
        }
        views = self.views.reshape(height, 2, width, 2).max(axis=(1, 3))
        return Capture(scale_rig(self.rig, 0.5), images, depth, self.label[::2, ::2], views)


def captured(folder: Path) -> Capture:
    """What the simulator wrote."""
    rig = read_rig(folder / "truth" / "rig.json")
    truth = np.load(next((folder / "truth").glob("*_depth.npz")))
    depth_mm, label, views = (truth[name] for name in ("depth_mm", "label", "views"))
    images = {name: read_image(next((folder / name).glob("000.*"))) for name in rig.cameras}
    return Capture(rig, images, depth_mm, label, views)


def lessons(folder: Path, turn: int) -> Iterator[Lesson]:
    """A capture's frames: as it is, and spoiled in some ways; in all over `EVERY` turns."""
    capture = captured(folder)
    every = capture.rig.auxiliaries
    ways = (
        (every[:3], "standard", same),
        (every[1::2], "standard", same),
        (every[:1], "standard", same),
        (every, "fine", same),
        (every, "standard", noisy),
        (every, "standard", uneven),
        (every[:2], "standard", blurred),
        (every, "standard", strangers),
        (every, "standard", blank),
    )
    for way in ((every, "standard", same), *ways[turn % EVERY :: EVERY]):
        yield capture.lesson(*way)
    if turn % EVERY == 0 and capture.rig.core_camera.size_px[0] >= HALVED_FROM_PX:
        yield capture.halved().lesson(every, "standard", same)


def same(images: Images) -> Images:
    """As they were taken."""
    return images


def noisy(images: Images) -> Images:
    """With more noise than a sensor has."""
    rng = np.random.default_rng(1)
    return {name: _pixels(image + rng.normal(0, 4, image.shape), image) for name, image in images.items()}


def uneven(images: Images) -> Images:
    """One auxiliary darker than the others, and noise."""
    rng = np.random.default_rng(2)
    last = list(images)[-1]
    return {
        name: _pixels(image * (0.7 if name == last else 1) + rng.normal(0, 2, image.shape), image)
        for name, image in images.items()
    }


def blurred(images: Images) -> Images:
    """One auxiliary out of focus."""
    last = list(images)[-1]
    return {name: cv2.GaussianBlur(i, (0, 0), 2.0) if name == last else i for name, i in images.items()}


def strangers(images: Images) -> Images:
    """The auxiliaries see another scene."""
    core = next(iter(images))
    return {name: i if name == core else np.ascontiguousarray(i[::-1, ::-1]) for name, i in images.items()}


def blank(images: Images) -> Images:
    """Nothing to see: even grey at the top, darkening downwards, and black at the bottom; with noise."""
    rng = np.random.default_rng(3)

    def one(image: np.ndarray) -> np.ndarray:
        shade = np.interp(np.linspace(0, 1, len(image)), (0, 0.4, 0.8, 0.8001, 1), (90, 90, 20, 0, 0))
        shape = (-1, *[1] * (image.ndim - 1))
        return _pixels(shade.reshape(shape) + rng.normal(0, 1.5, image.shape), image)

    return {name: one(image) for name, image in images.items()}


def _pixels(values: np.ndarray, like: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(values), 0, np.iinfo(like.dtype).max).astype(like.dtype)
