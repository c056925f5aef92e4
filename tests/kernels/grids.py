"""Surfaces on the core's grid, views of them and smooth images, for the tests of the grid kernels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from beltscape.core.geometry.pose import Pose
from beltscape.kernels.arrays import CellIndices
from beltscape.kernels.projection import pack_lens
from beltscape.kernels.reference.view import project

WIDTHS = (1, 2, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31, 33, 53)
"""Full lanes and every kind of tail for 4, 8 and 16 of them."""


PINHOLE = pack_lens("brown", np.zeros(5))
"""The lens of a packed projection without distortion."""
STRAIGHT = np.concatenate([[1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 0, 0, 1, 1, 0, 0], PINHOLE]).astype(np.float32)
"""A view that sees core pixel (u, v) at (u + s, v), as near as the core does."""


def view_of_seed(seed: int, width: int = 48, height: int = 40) -> np.ndarray:
    """(39,) an auxiliary beside the core; both see about `width` × `height` px with a focal length near 60 px."""
    rng = np.random.default_rng(seed)
    focal, center = rng.uniform(50, 80, 2), np.array([width, height]) / 2 + rng.uniform(-3, 3, 2)
    pinhole = np.array([[60, 0, width / 2], [0, 60, height / 2], [0, 0, 1]])
    turn = Pose.of(rng.uniform(-0.1, 0.1, 3), np.zeros(3)).rotation
    shift = rng.uniform(-1, 1, 3) / 60
    lens = rng.uniform(-1, 1, 5) * [0.15, 0.05, 2e-3, 2e-3, 0.03] + [0, 0.05, 0, 0, 0]
    direction = turn @ np.linalg.inv(pinhole)
    return np.concatenate([direction.ravel(), shift, focal, center, pack_lens("brown", lens)]).astype(
        np.float32
    )


def surface(seed: int, height: int, width: int, holes: float = 0.1) -> np.ndarray:
    """(height, width) float32 inverse depth about 10 with steps in it, and a share of NaN."""
    rng = np.random.default_rng(seed)
    s = 10 + rng.uniform(-2, 2) * np.sign(np.arange(width) - width * rng.random()) + np.zeros((height, 1))
    s = s + rng.normal(0, 0.2, s.shape)
    s[rng.random(s.shape) < holes] = np.nan
    return s.astype(np.float32)


def texture(seed: int, height: int, width: int) -> np.ndarray:
    """(height, width) float32 grey values 0 … 255, neighbours alike."""
    noise = np.random.default_rng(seed).normal(size=(height, width))
    return np.clip(128 + 150 * gaussian_filter(noise, 1.0), 0, 255).astype(np.float32)


def project_grid(
    view: NDArray[np.floating], s: NDArray[np.floating]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the auxiliary's pixels (u, v), (H, W) each, of all pixels of the core at their inverse depth."""
    height, width = s.shape
    u, v = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    found_u, found_v, _ = project(view, u, v, s.astype(float))
    return found_u, found_v


def height_field(seed: int, height: int, width: int, holes: float) -> np.ndarray:
    """(height, width) heights about 0 on a slope, and a share of values that are not finite."""
    rng = np.random.default_rng(seed)
    field = rng.normal(size=(height, width)) + rng.normal() * np.arange(width)
    field[rng.random(field.shape) < holes] = rng.choice([np.nan, np.nan, np.inf, -np.inf])
    return field


def cells_in(seed: int, shape: tuple[int, ...], count: int) -> CellIndices:
    """Random cells of a field in random order, corners among them."""
    rng = np.random.default_rng(seed)
    corners = [[0, 0], [shape[0] - 1, 0], [0, shape[1] - 1], [shape[0] - 1, shape[1] - 1]]
    all_cells = np.concatenate([np.array(corners)[: count // 2], rng.integers(0, shape, (count, 2))])[:count]
    rows, columns = rng.permutation(all_cells).T
    return rows, columns


def assert_identical(found: tuple[np.ndarray, ...], expected: tuple[np.ndarray, ...]) -> None:
    """Demand equal arrays of equal types."""
    for a, b in zip(found, expected, strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)
