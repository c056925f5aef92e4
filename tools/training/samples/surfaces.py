"""Simulated surfaces with holes and noise, without a unit: smooth ones and piles, and bodies with vertical sides.

Holes of the smooth ones lie anywhere, and the surface continues in them. Those of the bodies are what cameras do not
see: beside a vertical side, which a heap's rocks hardly have, the height is that of the ground up to the side.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from beltscape.measure.surface import Grid
from beltscape.measure.volume.load import Load

SHAPE = (160, 160)
"""Rows and columns of a surface."""
_REACH = 70
"""Largest distance of a pile's or a body's centre from the middle, in cells, in each direction."""
_CORE_SLOPE, _AUXILIARY_SLOPE = 0.4, 0.7
"""Largest slopes of the rays of the core and of an auxiliary in each direction: views up to 30° and 45° off."""
_STEP = 0.5
"""Cells between the points of a ray at which heights are compared."""

Surface = tuple[Load, np.ndarray]
"""A measured load, and its true height (Ny, Nx) in cells."""


def simulate_smooth_surface(rng: np.random.Generator) -> Surface:
    """Return a random smooth surface or some piles with noise, which continue in their holes."""
    x, y = _locate_cells()
    truth = _draw_plane(x, y, 0.8, rng)
    waves = ndimage.gaussian_filter(rng.standard_normal(SHAPE), rng.uniform(10, 40), mode="wrap")
    truth = truth + rng.uniform(0, 0.5) * waves / np.std(np.diff(waves, axis=0))
    truth += -truth.min() + rng.choice([0.0, 10.0, 100.0])
    if rng.random() < 0.6:
        truth = np.maximum(0.1 * truth, simulate_piles(x, y, rng))
    seeds = rng.random(SHAPE) < 10 ** rng.uniform(-3.3, -2)
    hole = ndimage.distance_transform_edt(~seeds) < rng.uniform(1, 14, SHAPE)
    if rng.random() < 0.3:  # single missing pixels
        hole |= rng.random(SHAPE) < rng.uniform(0.02, 0.3)
    return _measure(truth, hole, rng.uniform(-_CORE_SLOPE, _CORE_SLOPE, 2), rng)


def simulate_piles(x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the (Ny, Nx) heights of random cones, domes and balls on a level plane."""
    height = np.zeros(x.shape)
    for across, along, reach in rng.uniform(
        [-_REACH, -_REACH, 20], [_REACH, _REACH, 60], (rng.integers(1, 4), 3)
    ):
        radius = np.hypot(x - across, y - along) / reach
        high = reach * rng.uniform(0.3, 1.0)
        shape = [1 - radius, 1 - radius**2, np.sqrt(np.clip(1 - radius**2, 0, None))][rng.integers(3)]
        height = np.maximum(height, high * shape)
    return height


def simulate_bodies_seen(rng: np.random.Generator) -> Surface:
    """Return random bodies on a plane with noise; their holes are what the core, or no auxiliary, sees."""
    x, y = _locate_cells()
    ground = _draw_plane(x, y, 0.3, rng)
    truth = (ground - ground.min()) * rng.choice([0.0, 0.0, 0.5]) + simulate_bodies(x, y, rng)
    slope = rng.uniform(-_CORE_SLOPE, _CORE_SLOPE, 2)
    hole = mask_hidden(truth, slope)
    if rng.random() < 0.5:
        slopes = rng.uniform(-_AUXILIARY_SLOPE, _AUXILIARY_SLOPE, (rng.integers(1, 5), 2))
        hole |= np.all([mask_hidden(truth, one) for one in slopes], axis=0)
    if rng.random() < 0.3:
        hole |= rng.random(SHAPE) < rng.uniform(0, 0.1)
    return _measure(truth, hole, slope, rng)


def simulate_bodies(x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the (Ny, Nx) heights of random blocks, upright and lying cylinders on a level plane."""
    height = np.zeros(x.shape)
    for _ in range(rng.integers(1, 6)):
        turn = np.exp(1j * np.pi * rng.random())
        place = (x - rng.uniform(-_REACH, _REACH) + 1j * (y - rng.uniform(-_REACH, _REACH))) * turn
        half, half_length = rng.uniform(6, 40, 2)
        high = rng.uniform(2, 60)
        shapes = (
            np.where((np.abs(place.real) < half) & (np.abs(place.imag) < half_length), high, 0.0),
            np.where(np.abs(place) < half, high, 0.0),
            np.where(
                np.abs(place.imag) < half_length,
                min(high, half) * np.sqrt(np.clip(1 - (place.real / half) ** 2, 0, None)),
                0.0,
            ),
        )
        height = np.maximum(height, shapes[rng.integers(len(shapes))])
    return height


def mask_hidden(height: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Return the mask of the cells of a surface (Ny, Nx) that a far camera does not see.

    ``slope`` (2,) is that of its rays from the vertical in x and y, positive away from the camera.
    """
    steep = float(np.hypot(*slope))
    hidden = np.zeros(height.shape, bool)
    rows, columns = np.indices(height.shape)
    for distance in np.arange(_STEP, float(np.ptp(height)) * steep + _STEP, _STEP):
        towards = [rows - distance * slope[1] / steep, columns - distance * slope[0] / steep]
        before = ndimage.map_coordinates(height, towards, order=0, mode="nearest")
        hidden |= before - distance / steep > height + 1e-6
    return hidden


def _locate_cells() -> tuple[np.ndarray, np.ndarray]:
    """Return x and y (Ny, Nx) of the cells about the middle."""
    rows, columns = SHAPE
    x, y = np.meshgrid(np.arange(columns) - columns / 2, np.arange(rows) - rows / 2)
    return x, y


def _draw_plane(x: np.ndarray, y: np.ndarray, steepest: float, rng: np.random.Generator) -> np.ndarray:
    slope = rng.uniform(0, steepest) * np.exp(2j * np.pi * rng.random())
    return slope.real * x + slope.imag * y


def _measure(truth: np.ndarray, hole: np.ndarray, slope: np.ndarray, rng: np.random.Generator) -> Surface:
    """Return a surface measured with noise outside its holes by rays of one slope."""
    noise = 10 ** rng.uniform(-2.5, -0.5) * rng.standard_normal(SHAPE)
    measured = np.where(hole, np.nan, truth + noise)
    ray_slope = np.full((2, *SHAPE), slope[:, None, None])
    load = Load(Grid((0.0, 0.0), 1.0, SHAPE), measured, measured, measured, ~hole, ray_slope)
    return load, truth
