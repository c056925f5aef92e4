"""Doubtful pixels scrutinised: whether they are right, told by all evidence and their surroundings pixel by pixel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels
from beltscape.stereo.belief import fitted
from beltscape.stereo.places import Place, places
from beltscape.stereo.side_by_side import side_by_side
from beltscape.stereo.surface import Surface
from beltscape.stereo.surroundings import Surroundings, picked

Array = NDArray[np.floating]

DOUBTFUL = 3.5
"""A logit up to which a pixel is scrutinised."""
_PIXELS = 4096
"""So many are looked at at a time."""


@dataclass(frozen=True, slots=True, eq=False)
class Scrutiny:
    """All that doubtful pixels are scrutinised by."""

    planes: Mapping[str, Array]
    """(H, W) evidence by name, an ``impression`` among it."""
    surface: Surface
    surroundings: Surroundings

    @classmethod
    def of(
        cls, planes: Mapping[str, Array], surface: Surface, core: Array, scale: float, kernels: Kernels
    ) -> Scrutiny:
        """Of the evidence, the surface and the core's levels (H, W)."""
        around = Surroundings.of(surface.s, planes["impression"], core, scale, kernels)
        return cls(planes, surface, around)

    def look(self, at: Place) -> dict[str, Array]:
        """The evidence (1, N) of some pixels by name."""
        surface, around = self.surface, self.surroundings
        own = picked(self.planes, at, around.kernels)
        planes = (plane[at] for plane in (surface.s, surface.slope_u, surface.slope_v))
        found = own | around.about(at) | around.relief(at, *planes)
        return {name: values[None] for name, values in found.items()}


def scrutinised(logit: NDArray[np.float32], scrutiny: Scrutiny, threads: int) -> NDArray[np.float32]:
    """(H, W) logits, those of doubtful pixels anew."""
    belief, found = fitted("scrutiny"), logit.copy()

    def settle(at: Place) -> None:
        (answer,) = belief.answers(scrutiny.look(at), scrutiny.surroundings.kernels, 1)
        found[at] = answer[0]

    side_by_side([partial(settle, at) for at in places(logit < DOUBTFUL, _PIXELS)], threads)
    return found
