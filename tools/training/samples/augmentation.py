"""Training frames: simulated captures with truth, as they are and augmented by the disturbances of a plant."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig, scale_rig
from beltscape.core.progress import Silent
from beltscape.files.images import read_image
from beltscape.files.rig_json import read_rig
from beltscape.stereo.multiview.depth_range import find_depth_range

Images = dict[str, np.ndarray]
Augmentation = Callable[[Images], Images]
ON_FAILURE_MM = (560.0, 800.0)
"""Depth range of captures without a visible surface, which are training frames as well."""
EVERY = 3
"""Each capture takes every third augmentation; the following captures take the others."""
HALVED_FROM_PX = 1000
"""Width from which on a capture is also used at half size."""
ONE_SURFACE_MM = 4.0
"""Range of the depths of four pixels up to which they are one surface."""


@dataclass(frozen=True)
class TrainingFrame:
    """A frame with its rig, auxiliaries and truth."""

    rig: Rig
    names: tuple[str, ...]
    """The auxiliaries."""
    frame: FrameSet
    near_far_mm: tuple[float, float]
    depth_mm: np.ndarray
    label: np.ndarray
    views: np.ndarray
    """How many auxiliaries see a pixel's point."""
    lit: np.ndarray
    """Whether the projector lights it."""
    is_false: bool
    """Whether the images show no scene, or different ones: every surface is false."""


@dataclass(frozen=True)
class Capture:
    """A simulated frame, and the truth of the core's pixels."""

    rig: Rig
    images: Images
    depth_mm: np.ndarray
    label: np.ndarray
    views: np.ndarray
    """How many auxiliaries see a pixel's point."""
    lit: np.ndarray
    """Whether the projector lights it."""

    def training_frame(self, names: tuple[str, ...], augment: Augmentation) -> TrainingFrame:
        """Return the frame with these auxiliaries and an augmentation."""
        frame = FrameSet("000", augment({name: self.images[name] for name in (self.rig.core, *names)}))
        try:
            near_far = find_depth_range(self.rig, frame, Silent())
        except ReconstructionError:
            near_far = ON_FAILURE_MM
        return TrainingFrame(
            self.rig, names, frame, near_far, self.depth_mm, self.label, self.views, self.lit,
            augment in (mismatched, blank),
        )  # fmt: skip

    def halve(self) -> Capture:
        """Return the capture at half size; depth is NaN where four pixels are not one surface."""
        height, width = (side // 2 for side in self.depth_mm.shape)
        blocks = self.depth_mm.reshape(height, 2, width, 2)
        depth = np.where(
            np.ptp(blocks, axis=(1, 3)) < ONE_SURFACE_MM, 1 / (1 / blocks).mean(axis=(1, 3)), np.nan
        )
        images = {
            name: cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
            for name, image in self.images.items()
        }
        views = self.views.reshape(height, 2, width, 2).max(axis=(1, 3))
        label, lit = self.label[::2, ::2], self.lit[::2, ::2]
        return Capture(scale_rig(self.rig, 0.5), images, depth, label, views, lit)


def read_simulated(folder: Path) -> Capture:
    """Return a capture of the simulator."""
    rig = read_rig(folder / "truth" / "rig.json")
    truth = np.load(next((folder / "truth").glob("*_depth.npz")))
    depth_mm, label, views, lit = (truth[name] for name in ("depth_mm", "label", "views", "lit"))
    images = {name: read_image(next((folder / name).glob("000.*"))) for name in rig.cameras}
    return Capture(rig, images, depth_mm, label, views, lit)


def training_frames(folder: Path, turn: int) -> Iterator[TrainingFrame]:
    """Yield a capture's training frames: as it is, and with some augmentations; with all over `EVERY` turns."""
    capture = read_simulated(folder)
    auxiliaries = capture.rig.auxiliaries
    augmentations = (
        (auxiliaries[:3], unchanged),
        (auxiliaries[1::2] or auxiliaries, unchanged),
        (auxiliaries[:1], unchanged),
        (auxiliaries[:2], noisy),
        (auxiliaries, noisy),
        (auxiliaries, uneven),
        (auxiliaries[:2], blurred),
        (auxiliaries, mismatched),
        (auxiliaries, blank),
    )
    for augmentation in ((auxiliaries, unchanged), *augmentations[turn % EVERY :: EVERY]):
        yield capture.training_frame(*augmentation)
    if turn % EVERY == 0 and capture.rig.core_camera.size_px[0] >= HALVED_FROM_PX:
        yield capture.halve().training_frame(auxiliaries, unchanged)


def unchanged(images: Images) -> Images:
    """Return the images as they are."""
    return images


def noisy(images: Images) -> Images:
    """Return the images with more noise than a sensor's."""
    rng = np.random.default_rng(1)
    return {name: _as_pixels(image + rng.normal(0, 4, image.shape), image) for name, image in images.items()}


def uneven(images: Images) -> Images:
    """Return the images with one auxiliary darker than the others, and noise."""
    rng = np.random.default_rng(2)
    last = list(images)[-1]
    return {
        name: _as_pixels(image * (0.7 if name == last else 1) + rng.normal(0, 2, image.shape), image)
        for name, image in images.items()
    }


def blurred(images: Images) -> Images:
    """Return the images with one auxiliary out of focus."""
    last = list(images)[-1]
    return {name: cv2.GaussianBlur(i, (0, 0), 2.0) if name == last else i for name, i in images.items()}


def mismatched(images: Images) -> Images:
    """Return the images with the auxiliaries turned, so that they show another scene."""
    core = next(iter(images))
    return {name: i if name == core else np.ascontiguousarray(i[::-1, ::-1]) for name, i in images.items()}


def blank(images: Images) -> Images:
    """Return images without texture: even grey at the top, darker downwards, black at the bottom; with noise."""
    rng = np.random.default_rng(3)

    def one(image: np.ndarray) -> np.ndarray:
        shade = np.interp(np.linspace(0, 1, len(image)), (0, 0.4, 0.8, 0.8001, 1), (90, 90, 20, 0, 0))
        shape = (-1, *[1] * (image.ndim - 1))
        return _as_pixels(shade.reshape(shape) + rng.normal(0, 1.5, image.shape), image)

    return {name: one(image) for name, image in images.items()}


def _as_pixels(values: np.ndarray, like: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(values), 0, np.iinfo(like.dtype).max).astype(like.dtype)
