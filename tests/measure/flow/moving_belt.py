"""A smooth heap on a moving belt under a small camera: exact depth, without any rendering."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from beltscape.measure.belt.empty_belt import find_belt
from beltscape.measure.belt.reference import EmptyBeltReference, make_reference

HEIGHT_MM = 700.0
SIZE_PX = (180, 150)
CAMERA = Camera("cam0", SIZE_PX, np.full(2, 190.0), (np.array(SIZE_PX) - 1) / 2, np.zeros(5))
NOISE_MM = 0.2
FEW_PX = (120, 100)
COARSE_CAMERA = Camera("cam0", FEW_PX, np.full(2, 127.0), (np.array(FEW_PX) - 1) / 2, np.zeros(5))
"""The same view with larger pixels, for tests of what is done with the measurements."""


@dataclass(frozen=True, eq=False)
class Heap:
    """Hills on a ridge from ``start`` to ``end`` along the belt's own y; height 0 outside."""

    start_mm: float = 0.0
    end_mm: float = 1500.0
    crown_mm: float = 50.0
    half_width_mm: float = 150.0
    hills_mm: float = 7.0
    seed: int = 3
    waves: NDArray[np.float64] = field(init=False)

    def __post_init__(self) -> None:
        rng = np.random.default_rng(self.seed)
        length = rng.uniform(35.0, 110.0, 16)
        angle, phase = rng.uniform(0, np.pi, 16), rng.uniform(0, 2 * np.pi, 16)
        k = 2 * np.pi / length
        object.__setattr__(self, "waves", np.stack([k * np.cos(angle), k * np.sin(angle), phase]))

    def height_mm(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height over the belt at x and the belt's own y."""
        x, y = np.broadcast_arrays(x, y)
        across = np.clip(1 - (x / self.half_width_mm) ** 2, 0, None)
        along = np.clip((y - self.start_mm) / 120, 0, 1) * np.clip((self.end_mm - y) / 120, 0, 1)
        inside = (across > 0) & (along > 0)
        out, x, y = np.zeros(x.shape), x[inside], y[inside]
        kx, ky, phase = self.waves[:, :, None]
        angle = (kx * x + ky * y + phase).astype(np.float32)  # whose sine is many times cheaper
        hills = np.sin(angle).sum(axis=0) * np.sqrt(2 / 16)
        out[inside] = across[inside] * along[inside] * (self.crown_mm + self.hills_mm * hills)
        return out

    @property
    def volume_mm3(self) -> float:
        return self.volume_between_mm3(self.start_mm, self.end_mm)

    def volume_between_mm3(self, start_mm: float, end_mm: float) -> float:
        """Between two places of the belt's own y."""
        x = np.arange(-self.half_width_mm, self.half_width_mm, 1.0) + 0.5
        y = np.arange(start_mm, end_mm, 1.0) + 0.5
        return float(self.height_mm(x[None], y[:, None]).sum())


def trough_mm(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cross-section of the empty belt: a level middle of 200 mm and wings of 20°."""
    return np.clip(np.abs(x) - 100, 0, None) * np.tan(np.deg2rad(20.0))


@lru_cache(128)
def depth_map(
    heap: Heap | None,
    position_mm: float,
    direction: int = 1,
    *,
    seed: int = 0,
    noise_mm: float = NOISE_MM,
    camera: Camera = CAMERA,
) -> DepthMap:
    """What the camera measures when the belt has moved so far; the heap's own y is the belt frame's at position 0."""
    rays = camera.rays()
    depth = np.full(rays.shape[:2], HEIGHT_MM)
    for _ in range(10):  # the surface is far less steep than the rays: this converges
        x, y = rays[..., 0] * depth, -rays[..., 1] * depth
        load = 0.0 if heap is None else heap.height_mm(x, y - direction * position_mm)
        depth += 0.8 * (HEIGHT_MM - trough_mm(x) - load - depth)
    rng = np.random.default_rng([seed, round(position_mm * 1000) % 2**31, 5])
    noisy = depth + noise_mm * rng.normal(size=depth.shape)
    ones = np.ones(depth.shape, np.float32)
    return DepthMap(
        noisy.astype(np.float32),
        (noise_mm + 0.01) * ones,  # pyrefly: ignore[bad-argument-type]
        np.full(depth.shape, 4, np.uint8),
        ones,
    )


def add_standing_errors(depth: DepthMap, sigma_mm: float, reach_px: float = 3.0) -> DepthMap:
    """Add errors that every frame has at the same pixels, as matching has below a static pattern."""
    errors = ndimage.gaussian_filter(np.random.default_rng(77).normal(size=depth.depth_mm.shape), reach_px)
    errors *= sigma_mm / errors.std()
    return replace(depth, depth_mm=(depth.depth_mm + errors).astype(np.float32))


@lru_cache
def make_empty_belt(camera: Camera = CAMERA) -> EmptyBeltReference:
    """The empty belt's floor, for depth maps of a camera."""
    empty = depth_map(None, 0.0, seed=99)
    return make_reference(find_belt(empty, CAMERA), camera)
