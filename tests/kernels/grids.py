"""Surfaces on the core's grid, views of them and smooth images, for the tests of the grid kernels."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from beltscape.core.pose import Pose

WIDTHS = (1, 2, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31, 33, 53)
"""Full lanes and every kind of tail for 4, 8 and 16 of them."""


def view_of_seed(seed: int, width: int = 48, height: int = 40) -> np.ndarray:
    """(21,) an auxiliary beside the core; both see about `width` × `height` px with a focal length near 60 px."""
    rng = np.random.default_rng(seed)
    focal, center = rng.uniform(50, 80, 2), np.array([width, height]) / 2 + rng.uniform(-3, 3, 2)
    pinhole = np.array([[60, 0, width / 2], [0, 60, height / 2], [0, 0, 1]])
    turn = Pose.of(rng.uniform(-0.1, 0.1, 3), np.zeros(3)).rotation
    shift = rng.uniform(-1, 1, 3) / 60
    lens = rng.uniform(-1, 1, 5) * [0.15, 0.05, 2e-3, 2e-3, 0.03] + [0, 0.05, 0, 0, 0]
    direction = turn @ np.linalg.inv(pinhole)
    return np.concatenate([direction.ravel(), shift, focal, center, lens]).astype(np.float32)


def surface(seed: int, height: int, width: int, holes: float = 0.1) -> np.ndarray:
    """(height, width) float32 nearness about 10 with steps in it, and a share of NaN."""
    rng = np.random.default_rng(seed)
    s = 10 + rng.uniform(-2, 2) * np.sign(np.arange(width) - width * rng.random()) + np.zeros((height, 1))
    s = s + rng.normal(0, 0.2, s.shape)
    s[rng.random(s.shape) < holes] = np.nan
    return s.astype(np.float32)


def texture(seed: int, height: int, width: int) -> np.ndarray:
    """(height, width) float32 grey values 0 … 255, neighbours alike."""
    noise = np.random.default_rng(seed).normal(size=(height, width))
    return np.clip(128 + 150 * gaussian_filter(noise, 1.0), 0, 255).astype(np.float32)
