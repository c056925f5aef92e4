"""Context features: values of the single neighbours of a pixel.

A feature of a window is a sum. Where exactly in the window the image changes, the surface leaves a plane or the
confidence falls distinguishes a pixel in front of a step from one behind it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels
from beltscape.stereo.multiview.frame.context import MatchContext
from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.planes import Pixels, fill_nan

Array = NDArray[np.floating]

_DARK = 8.0
"""Added to levels before the logarithm; differences between darker levels count little."""
_MOST_OFFSET_PX = 3.0
"""Limit of a neighbour's distance from a plane."""
_CENTRE = np.zeros((1, 2), int)
"""The pixel itself, without an offset."""


_OFFSETS = np.array([(du, dv) for dv, du in product((-1, 0, 1), repeat=2) if du or dv])
"""(8, 2) columns and rows to the eight neighbours."""


@dataclass(frozen=True, slots=True, eq=False)
class Neighbourhood:
    """The planes (H, W) whose values at neighbours are features."""

    s: Array
    """Inverse depth of the surface."""
    initial_confidence: Array
    """Logit."""
    log_level: NDArray[np.float32]
    """Logarithm of the core's level."""
    context: MatchContext

    @classmethod
    def from_surface(cls, s: Array, initial_confidence: Array, prepared: PreparedFrame) -> Neighbourhood:
        """Return the neighbourhood in a surface s, its initial confidence (H, W) and the core's levels."""
        log_level = np.log(np.maximum(prepared.filled_core, 0) + np.float32(_DARK))
        return cls(s, initial_confidence, log_level, prepared.context)

    @property
    def spacing(self) -> int:
        """Distance between neighbours, px."""
        return max(1, round(self.context.scale))

    def compute_image_features(self, pixels: Pixels) -> dict[str, Array]:
        """Return (N,) by name: each neighbour's initial confidence and its brightness relative to the pixel's."""
        confidence, level = self._gather([self.initial_confidence, self.log_level], pixels)
        return _name("initial confidence", confidence) | _name(
            "relative brightness", level - self.log_level[pixels]
        )

    def compute_offset_features(
        self, pixels: Pixels, s: Array, slopes: tuple[Array, Array]
    ) -> dict[str, Array]:
        """Return (N,) by name: each neighbour's distance in front of the pixel's plane, px at scale 1."""
        (neighbour_s,) = self._gather([self.s], pixels)
        du, dv = self.spacing * _OFFSETS.T[..., None].astype(np.float32)
        plane = s + slopes[0] * du + slopes[1] * dv
        offset = fill_nan(neighbour_s - plane) * np.float32(1 / self.context.scale)
        return _name("offset", np.clip(offset, -_MOST_OFFSET_PX, _MOST_OFFSET_PX))

    def _gather(self, planes: Sequence[Array], pixels: Pixels) -> Array:
        return self.context.kernels.gather(planes, pixels[1], pixels[0], self.spacing * _OFFSETS, threads=1)


@cache
def _list_names(feature: str) -> tuple[str, ...]:
    return tuple(f"{feature} at {du:+d} {dv:+d}" for du, dv in _OFFSETS)


def _name(feature: str, rows: Array) -> dict[str, Array]:
    return dict(zip(_list_names(feature), rows, strict=True))


def sample_planes(planes: Mapping[str, Array], pixels: Pixels, kernels: Kernels) -> dict[str, Array]:
    """Return (N,) values of planes (H, W) at some pixels, by name."""
    values = kernels.gather(list(planes.values()), pixels[1], pixels[0], _CENTRE, threads=1)
    return dict(zip(planes, values[:, 0], strict=True))
