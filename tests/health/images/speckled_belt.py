"""Images of a belt with material under projected speckle, seen by five cameras; drawn, not rendered."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import FrameSet, Image
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig

Levels = NDArray[np.float32]
SIZE = 400, 320
"""Width and height of the images, px."""
NAMES = ("cam0", "cam1", "cam2", "cam3", "cam4")
GAINS = dict(zip(NAMES, (1.0, 1.1, 0.92, 1.05, 0.97), strict=True))
AMBIENT = 6.0
TRAVEL_PX = 37
"""Motion of the material between two frames."""


def make_rig() -> Rig:
    """Return five parallel cameras 60 mm apart, 700 mm over the belt."""
    focal = np.array([400.0, 400.0])
    center = np.array([SIZE[0] / 2, SIZE[1] / 2])
    cameras = {name: Camera(name, SIZE, focal, center, np.zeros(5)) for name in NAMES}
    shifts = ((0, 0), (60, 0), (-60, 0), (0, 60), (0, -60))
    poses = {name: Pose.of(np.eye(3), (x, y, 0.0)) for name, (x, y) in zip(NAMES, shifts, strict=True)}
    return Rig("cam0", cameras, poses)


def _keep(_: str, light: Levels) -> Levels:
    return light


@lru_cache(128)
def make_frame(
    number: int,
    change: Callable[[str, Levels], Levels] = _keep,
    *,
    speckle: bool = True,
    standing: bool = False,
    lamp: float = 1.0,
    hall: float = 1.0,
    stones: float = 1.0,
) -> FrameSet:
    """Return frame ``number``; ``change`` receives the noise-free levels of every camera.

    ``lamp``, ``hall`` and ``stones`` multiply the projector's light, the hall's, and the material's reflectance.
    """
    scene = _draw_scene(0 if standing else number, speckle, lamp, hall, stones)
    images = {
        name: add_noise(change(name, GAINS[name] * scene), (number, index))
        for index, name in enumerate(NAMES)
    }
    return FrameSet(f"{number:03d}", images, number * 125_000_000)


def add_noise(light: Levels, seed: tuple[int, int]) -> Image:
    """Return the 8-bit image of levels with shot and read noise."""
    generator = np.random.default_rng(seed)
    sigma = np.sqrt(0.1 + 0.018 * np.maximum(light, 0))
    return np.rint(light + sigma * generator.standard_normal(light.shape)).clip(0, 255).astype(np.uint8)


def blur(light: Levels, sigma_px: float) -> Levels:
    """Return levels after a Gaussian blur."""
    return np.asarray(cv2.GaussianBlur(light, (0, 0), sigma_px), np.float32)


@lru_cache(64)
def _draw_scene(number: int, speckle: bool, lamp: float, hall: float, stones_share: float) -> Levels:
    width, height = SIZE
    # stones of differing reflectance that travel down the picture; bare belt on both sides
    stones = np.random.default_rng(1).uniform(0.5, 3.0, (400, 20)).astype(np.float32)
    first = 300 * 12 - number * TRAVEL_PX
    material = cv2.resize(stones, (20 * 12, 400 * 12), interpolation=cv2.INTER_NEAREST)
    reflectance = np.ones((height, width), np.float32)
    reflectance[:, 80:320] = stones_share * material[first : first + height]
    reflectance[:, :12] = 0.1  # beside the belt
    dots = np.random.default_rng(2).random((height, width)) < 0.06
    pattern = blur(dots.astype(np.float32), 0.9)
    pattern *= 1 / pattern.mean()
    if not speckle:
        pattern = np.full_like(pattern, 0.5)
    return reflectance * (AMBIENT * hall + 18 * lamp * pattern)
