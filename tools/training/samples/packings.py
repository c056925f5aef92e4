"""Simulated packings of bodies seen from above, with the body of each cell: what a heap's rocks hardly show.

Rocks of a heap touch. Bodies that lie alone, have flat tops or are as large as the view occur on belts too, and the
network of outlines has to know them.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from beltscape.measure.lumps.features import blur, fill_gaps

SHAPE = (240, 240)
"""Rows and columns of a packing: the widest features reach over a fifth of it."""
_SMALLEST, _LARGEST = 5.0, 75.0
"""Half widths of bodies, in cells: from the least lumps that are resolved to those that fill most of the view."""
_BURIED = 0.75
"""Largest share of a body's height below the ground."""
_STEEPEST_GROUND = 0.3
"""Slope of the steepest ground."""

Packing = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Heights (Ny, Nx) float32 in cells with noise, filled in holes; the cells measured, and the number of the body in
each cell, -1: none."""


def simulate_packing(rng: np.random.Generator) -> Packing:
    """Return random bodies of like size on a plane, lone or in a layer, with noise of the height."""
    rows, columns = SHAPE
    x, y = np.meshgrid(np.arange(columns) - columns / 2, np.arange(rows) - rows / 2)
    slope = rng.uniform(0, _STEEPEST_GROUND) * np.exp(2j * np.pi * rng.random())
    height, body = np.zeros(SHAPE), np.full(SHAPE, -1)
    typical = np.exp(rng.uniform(np.log(_SMALLEST), np.log(_LARGEST)))
    covered = 10 ** rng.uniform(-1, 0.3)
    number = max(1, round(covered * x.size / (4 * typical**2)))
    for one in range(number):
        own = _simulate_body(x, y, np.clip(typical * rng.lognormal(0, 0.3), _SMALLEST, _LARGEST), rng)
        above = own > height
        height[above], body[above] = own[above], one
    height += slope.real * x + slope.imag * y
    noise = 10 ** rng.uniform(-2.5, -0.5) * rng.standard_normal(SHAPE)
    if rng.random() < 0.5:  # a matcher's errors are alike among neighbours
        noise = 3 * blur(noise.astype(np.float32), 1.0)
    measured = _draw_measured(rng)
    return fill_gaps((height + noise).astype(np.float32), measured), measured, body


def _draw_measured(rng: np.random.Generator) -> np.ndarray:
    """Return the measured cells (Ny, Nx): all of them, or all but single cells and small holes."""
    missing = np.zeros(SHAPE, bool)
    if rng.random() < 0.5:
        seeds = rng.random(SHAPE) < 10 ** rng.uniform(-4, -2.5)
        missing = ndimage.distance_transform_cdt(~seeds, "chessboard") < rng.uniform(1, 5, SHAPE)
        missing |= rng.random(SHAPE) < rng.uniform(0, 0.2)
    return ~missing


def _simulate_body(x: np.ndarray, y: np.ndarray, half: float, rng: np.random.Generator) -> np.ndarray:
    """Return the heights (Ny, Nx) of a body of a half width above the plane, -inf beside it."""
    across, along = rng.uniform(-np.array(SHAPE[::-1]) / 2, np.array(SHAPE[::-1]) / 2)
    place = ((x - across) + 1j * (y - along)) * np.exp(1j * np.pi * rng.random())
    a, b = place.real / half, place.imag / (half * rng.uniform(0.6, 1.0))
    thick = 2 * half * rng.uniform(0.4, 1.0)
    shape = rng.integers(3)
    if shape == 0:  # an ellipsoid
        inside = a * a + b * b < 1
        top = (1 + np.sqrt(np.clip(1 - a * a - b * b, 0, None))) / 2
    elif shape == 1:  # a block, level or tilted
        inside = (np.abs(a) < 1) & (np.abs(b) < 1)
        top = 1 - rng.choice([0.0, 1.0]) * (rng.uniform(0, 0.3) * (1 + a) + rng.uniform(0, 0.3) * (1 + b)) / 2
    else:  # a convex body with broken faces
        turns = np.exp(2j * np.pi * (np.arange(5) + rng.random(5)) / 5)
        faces = [1 + rng.uniform(0.5, 4) * (rng.uniform(0.5, 0.9) - a * t.real - b * t.imag) for t in turns]
        tilt = rng.uniform(-0.3, 0.3, 2)
        top = np.minimum(np.min(faces, axis=0), 1 - tilt[0] * a - tilt[1] * b)
        inside = (top > 0) & (a * a + b * b < 4)
    return np.where(inside, thick * (top - rng.uniform(0, _BURIED)), -np.inf)
