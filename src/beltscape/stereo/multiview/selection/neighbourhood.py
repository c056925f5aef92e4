"""What surrounds a pixel, neighbour by neighbour.

What a window says is a sum; where exactly in it the image changes, the surface leaves a plane and doubt begins tells
a pixel beside a step from one beyond it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels
from beltscape.stereo.multiview.frame.nan import fill_nan
from beltscape.stereo.multiview.frame.pixels import Pixels

Array = NDArray[np.floating]

_DARK = 8.0
"""Levels; differences between darker ones count for little."""
_MOST_OFF_PX = 3.0
"""No neighbour counts as farther off a plane."""
_HERE = np.zeros((1, 2), int)


@cache
def _offsets(reach: int) -> NDArray[np.int_]:
    along = range(-reach, reach + 1)
    return np.array([(du, dv) for dv, du in product(along, repeat=2) if du or dv])


@cache
def _names(what: str, reach: int) -> tuple[str, ...]:
    return tuple(f"{what} at {du:+d} {dv:+d}" for du, dv in _offsets(reach))


@dataclass(frozen=True, slots=True, eq=False)
class Neighbourhood:
    """The planes (H, W) that are looked up."""

    s: Array
    """The surface."""
    impression: Array
    """Logit of a pixel's being right."""
    brightness: NDArray[np.float32]
    """Logarithm of the core's level."""
    reach: int
    """So far to each side they reach, px at scale 1."""
    scale: float
    kernels: Kernels

    @classmethod
    def of(
        cls, s: Array, impression: Array, core: Array, reach: int, scale: float, kernels: Kernels
    ) -> Neighbourhood:
        """Of a surface s, what is thought of it, and the core's levels (H, W), NaN where it sees nothing."""
        level = np.maximum(fill_nan(core), 0)
        return cls(s, impression, np.log(level + np.float32(_DARK)), reach, scale, kernels)

    @property
    def step(self) -> int:
        """From neighbour to neighbour, px."""
        return max(1, round(self.scale))

    def about(self, at: Pixels) -> dict[str, Array]:
        """What is thought of each neighbour, and how much brighter it is: (N,) by name."""
        impression, level = self._around([self.impression, self.brightness], at)
        return self._named("impression", impression) | self._named("brightness", level - self.brightness[at])

    def relief(self, at: Pixels, s: Array, slope_u: Array, slope_v: Array) -> dict[str, Array]:
        """How far each neighbour lies before the plane with which a pixel continues, px at scale 1: (N,) by name."""
        (near,) = self._around([self.s], at)
        du, dv = self.step * _offsets(self.reach).T[..., None].astype(np.float32)
        off = fill_nan(near - (s + slope_u * du + slope_v * dv)) * np.float32(1 / self.scale)
        return self._named("relief", np.clip(off, -_MOST_OFF_PX, _MOST_OFF_PX))

    def _named(self, what: str, rows: Array) -> dict[str, Array]:
        return dict(zip(_names(what, self.reach), rows, strict=True))

    def _around(self, planes: Sequence[Array], at: Pixels) -> Array:
        return self.kernels.gather(planes, at[1], at[0], self.step * _offsets(self.reach), threads=1)


def sample_planes(planes: Mapping[str, Array], at: Pixels, kernels: Kernels) -> dict[str, Array]:
    """(N,) of some pixels of planes (H, W) by name."""
    found = kernels.gather(list(planes.values()), at[1], at[0], _HERE, threads=1)
    return dict(zip(planes, found[:, 0], strict=True))
