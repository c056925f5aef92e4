"""How like the core's levels the auxiliaries' are on a surface: the levels themselves, at one brightness."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels
from beltscape.kernels.candidates import PhotoConsistency
from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.pixels import Pixels
from beltscape.stereo.multiview.frame.visibility import OCCLUDER_PX
from beltscape.stereo.multiview.selection.gain import PhotometricGain

Array = NDArray[np.floating]

_ROUND = 0.1
"""Differences below that are alike."""


@dataclass(frozen=True, slots=True, eq=False)
class PhotoConsistencyModel:
    """What surfaces are compared by."""

    prepared: PreparedFrame
    brightness: PhotometricGain
    buffers: Sequence[Array]
    """n of (h, w): how near to each auxiliary what hides others lies."""
    kernels: Kernels

    def of(self, at: Pixels, s: Array, slope_u: Array, slope_v: Array, threads: int = 1) -> PhotoConsistency:
        """Of n surfaces (n, N) at each of N pixels."""
        prepared = self.prepared
        return self.kernels.photo_consistency(
            at[1], at[0], s, slope_u, slope_v, core=prepared.core, variance=self.brightness.variance,
            images=prepared.images, views=prepared.views, buffers=self.buffers, gains=self.brightness.gains,
            tolerance=OCCLUDER_PX, threads=threads,
        )  # fmt: skip


def photo_consistency_features(like: PhotoConsistency, auxiliaries: int) -> Iterator[tuple[str, Array]]:
    """What the levels say of surfaces: differences by their logarithm, and who sees them."""
    for name, plane in zip(PhotoConsistency._fields[:-1], like[:-1], strict=True):
        yield name.replace("_", " "), np.log(plane + np.float32(_ROUND))
    yield "seen by", np.minimum(like.views, 4)
    yield "seen by share", like.views / np.float32(auxiliaries)
