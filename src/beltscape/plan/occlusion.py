"""What lumps hide: the chance that a spot between lumps which the core sees is seen by auxiliaries too.

The load is a Boolean model: balls of equal size lie on a plane, their feet a Poisson process, covering a given
share of it seen from above. A spot is seen along a direction when no ball is in the way, so that, with λ the number
of balls per area and U the set of feet whose balls would be in the way of any of several directions, all of them see
it with the chance exp(−λ|U|). Only directions and cover matter, not the size of the balls.

References
----------
Chiu, Stoyan, Kendall & Mecke, Stochastic Geometry and its Applications, 3rd ed. 2013, doi:10.1002/9781118658222.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_CELLS = 240
"""Cells along a side of the raster of feet: areas to about 0.2 %."""


def visible_shares(core: NDArray[np.float64], others: NDArray[np.float64], cover: float) -> tuple[float, ...]:
    """Chance that at least 0, 1, …, n of the other directions see a spot that the core sees.

    Parameters
    ----------
    core
        (2,) tangent of the direction to the core camera: sideways over upwards, along x and y.
    others
        (n, 2) of the auxiliaries; n up to 8.
    cover
        Share of the plane that balls cover, seen from above.
    """
    code, cell_area = _mark_occluders(np.vstack([core, others]))
    count = len(others)
    areas = np.bincount(code.ravel(), minlength=2 ** (count + 1)) * cell_area
    density = -np.log(1 - cover) / np.pi  # balls of radius 1
    codes = np.arange(len(areas))
    exactly = np.zeros(count + 1)
    # chance that the core and all of a set see it; then inclusion and exclusion
    whole = {s: np.exp(-density * areas[(codes & (2 * s + 1)) != 0].sum()) for s in range(2**count)}
    for s in whole:
        rest = (2**count - 1) ^ s
        exactly[s.bit_count()] += sum(
            (-1) ** extra.bit_count() * whole[s | extra] for extra in whole if extra & rest == extra
        )
    at_least = np.cumsum(exactly[::-1])[::-1] / whole[0]
    return tuple(float(share) for share in np.clip(at_least, 0, 1))


def _mark_occluders(tangents: NDArray[np.float64]) -> tuple[NDArray[np.int64], float]:
    """Bit i of a cell: a unit ball there hides the spot at the origin from direction i; and the cell's area."""
    reach = float(2 + 2 * np.abs(tangents).max())
    steps = (np.arange(_CELLS) + 0.5) / _CELLS * 2 * reach - reach
    x, y = np.meshgrid(steps, steps)
    feet = np.stack([x, y, np.ones_like(x)], axis=-1)  # centres lie one radius up
    code = np.zeros(x.shape, np.int64)
    for i, tangent in enumerate(tangents):
        ray = np.array([*tangent, 1.0]) / np.sqrt(1 + tangent @ tangent)
        distance2 = (feet**2).sum(axis=-1) - (feet @ ray) ** 2
        code |= (distance2 < 1).astype(np.int64) << i
    return code, (2 * reach / _CELLS) ** 2
