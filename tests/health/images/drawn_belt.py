"""Images of a belt with a heap under a projected pattern, for three small cameras.

The material's reflectance moves with the belt; the pattern stands still. Both are drawn at the exact surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import FrameSet, Image
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from tests.measure.flow.moving_belt import CAMERA, HEIGHT_MM, Heap, trough_mm

AUXILIARIES = {"cam1": (120.0, 0.0), "cam2": (0.0, 120.0)}
"""Centres, x and y in the core's frame."""
RIG = Rig(
    "cam0",
    {name: replace(CAMERA, name=name) for name in ("cam0", *AUXILIARIES)},
    {
        "cam0": Pose.identity(),
        **{name: Pose.of(np.eye(3), (-x, -y, 0.0)) for name, (x, y) in AUXILIARIES.items()},
    },
)
ALONG = np.array([0.0, -1.0, 0.0])
"""Direction of travel in the core's frame: +y of the belt."""
STEP_MM = 70.0
"""Travel between two frames."""
_CELL_MM = 4.0
_SIDE = 1000


def make_frame(
    number: int,
    heap: Heap | None,
    *,
    speed_mm_s: float = 1000.0,
    late_mm: Mapping[str, float] | None = None,
    moved_mm: tuple[float, float] = (0.0, 0.0),
    turned_deg: float = 0.0,
    speckle: float = 0.5,
    images_of: Mapping[str, int] | None = None,
) -> FrameSet:
    """Return frame ``number`` of a belt that moves by `STEP_MM` per frame.

    ``late_mm`` is the travel by which a camera is late, ``moved_mm`` the displacement of the pattern on the belt,
    ``turned_deg`` its rotation, ``speckle`` its contrast, ``images_of`` the frame that a camera shows instead.
    """
    images: dict[str, Image] = {}
    for index, name in enumerate(RIG.cameras):
        shown = number if images_of is None else images_of.get(name, number)
        position = STEP_MM * shown + (late_mm or {}).get(name, 0.0)
        images[name] = _draw(
            AUXILIARIES.get(name, (0.0, 0.0)),
            heap,
            position,
            (*moved_mm, turned_deg),
            speckle,
            (shown, index),
        )
    return FrameSet(f"{number:03d}", images, round(number * STEP_MM / speed_mm_s * 1e9))


@lru_cache(256)
def _draw(
    center_mm: tuple[float, float],
    heap: Heap | None,
    position_mm: float,
    moved: tuple[float, float, float],
    speckle: float,
    seed: tuple[int, int],
) -> Image:
    rays = CAMERA.rays()
    depth = np.full(rays.shape[:2], HEIGHT_MM)
    load = np.zeros(depth.shape)
    for _ in range(10):
        x, y = center_mm[0] + rays[..., 0] * depth, -center_mm[1] - rays[..., 1] * depth
        load = load if heap is None else heap.height_mm(x, y - position_mm)
        depth += 0.8 * (HEIGHT_MM - trough_mm(x) - load - depth)
    x, y = center_mm[0] + rays[..., 0] * depth, -center_mm[1] - rays[..., 1] * depth
    stones = _sample(1, x, y - position_mm)
    reflectance = np.where(load > 1, 0.4 + 0.8 * stones, 0.3)
    cosine, sine = np.cos(np.deg2rad(moved[2])), np.sin(np.deg2rad(moved[2]))
    u, v = x - moved[0], y - moved[1]
    light = 1 - speckle + 2 * speckle * _sample(2, cosine * u + sine * v, cosine * v - sine * u)
    noise = np.random.default_rng(seed).normal(size=x.shape)
    return np.rint(90 * reflectance * light + 1.0 * noise).clip(0, 255).astype(np.uint8)


def _sample(seed: int, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return random values, 0..1, that repeat after four metres, at positions (H, W)."""
    values = _draw_values(seed)
    columns, rows = ((part / _CELL_MM % _SIDE).astype(np.float32) for part in (x_mm, y_mm))
    return np.asarray(cv2.remap(values, columns, rows, cv2.INTER_LINEAR), np.float32)


@cache
def _draw_values(seed: int) -> NDArray[np.float32]:
    return np.random.default_rng(seed).random((_SIDE, _SIDE)).astype(np.float32)
