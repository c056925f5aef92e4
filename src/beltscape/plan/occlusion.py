"""Occlusion by lumps: the probability that auxiliaries see a spot between lumps that the core sees.

The load is a Boolean model: balls of equal size lie on a plane, their contact points a Poisson process, covering a
given share of it seen from above. A spot is seen along a direction when no ball occludes it. With λ the number of
balls per area and U the set of contact points whose balls would occlude any of several directions, all of them see
it with probability exp(−λ|U|). Only directions and cover matter, not the size of the balls.

References
----------
Chiu, Stoyan, Kendall & Mecke, Stochastic Geometry and its Applications, 3rd ed. 2013, doi:10.1002/9781118658222.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_CELLS = 240
"""Cells per side of the raster of contact points: areas are accurate to about 0.2 %."""


def visible_shares(core: NDArray[np.float64], others: NDArray[np.float64], cover: float) -> tuple[float, ...]:
    """Return the probability that at least 0, 1, …, n of the other directions see a spot that the core sees.

    Parameters
    ----------
    core
        (2,) tangent of the direction to the core camera: horizontal over vertical, along x and y.
    others
        (n, 2) of the auxiliaries; n is at most 8.
    cover
        Share of the plane covered by balls, seen from above.
    """
    code, cell_area = _mark_occluders(np.vstack([core, others]))
    count = len(others)
    areas = np.bincount(code.ravel(), minlength=2 ** (count + 1)) * cell_area
    density = -np.log(1 - cover) / np.pi  # balls of radius 1
    codes = np.arange(len(areas))
    exactly = np.zeros(count + 1)
    # probability that the core and all of a set see it; then inclusion–exclusion
    all_of_set = {s: np.exp(-density * areas[(codes & (2 * s + 1)) != 0].sum()) for s in range(2**count)}
    for s in all_of_set:
        rest = (2**count - 1) ^ s
        exactly[s.bit_count()] += sum(
            (-1) ** extra.bit_count() * all_of_set[s | extra] for extra in all_of_set if extra & rest == extra
        )
    at_least = np.cumsum(exactly[::-1])[::-1] / all_of_set[0]
    return tuple(float(share) for share in np.clip(at_least, 0, 1))


def _mark_occluders(tangents: NDArray[np.float64]) -> tuple[NDArray[np.int64], float]:
    """Return cells whose bit i is set if a unit ball there occludes the origin from direction i, and their area."""
    reach = float(2 + 2 * np.abs(tangents).max())
    steps = (np.arange(_CELLS) + 0.5) / _CELLS * 2 * reach - reach
    x, y = np.meshgrid(steps, steps)
    centers = np.stack([x, y, np.ones_like(x)], axis=-1)  # centres lie one radius up
    square = x**2 + y**2 + 1
    code = np.zeros(x.shape, np.int64)
    for i, tangent in enumerate(tangents):
        ray = np.array([*tangent, 1.0]) / np.sqrt(1 + tangent @ tangent)
        distance2 = square - (centers @ ray) ** 2
        code |= (distance2 < 1).astype(np.int64) << i
    return code, (2 * reach / _CELLS) ** 2
