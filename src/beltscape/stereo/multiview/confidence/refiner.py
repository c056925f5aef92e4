"""Doubtful pixels scrutinised: moved to where they belong, and judged anew.

What speaks of them is all evidence, their surroundings pixel by pixel, and how like the images would be a little
nearer and farther; then they hear each other (`messages`). Planes fitted over windows cut edges and round flanks;
that shows in the surroundings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.confidence.message_passing import (
    assign_addresses,
    load_message_rounds,
    neighbour_addresses,
    pass_messages,
)
from beltscape.stereo.multiview.frame.parallel import run_parallel
from beltscape.stereo.multiview.frame.pixels import Pixels, split_pixels
from beltscape.stereo.multiview.frame.surface import Surface
from beltscape.stereo.multiview.networks import load_network
from beltscape.stereo.multiview.selection.neighbourhood import Neighbourhood, sample_planes
from beltscape.stereo.multiview.selection.photoconsistency import (
    PhotoConsistencyModel,
    photo_consistency_features,
)

Array = NDArray[np.floating]

_LOST, _SURE = -2.0, 5.5
"""Logits: nobody will believe a lesser one, nor doubt a greater."""
TRIED_PX = (-1.5, -0.8, -0.4, 0.4, 0.8, 1.5)
"""So much nearer and farther the images are compared, at scale 1."""
AROUND_PX = 1
"""So far about a pixel it is looked at, at scale 1: of who is farther off it hears."""
MOST_PX = 2.0
"""No pixel is moved by more, at scale 1."""
_PIXELS = 4096
"""So many are looked at at a time."""


class Prediction(NamedTuple):
    """Of pixels, or of all (H, W)."""

    s: NDArray[np.float32]
    """Nearness."""
    logit: NDArray[np.float32]
    """Of its being right."""
    log_sigma: NDArray[np.float32]
    """Of s, px."""


@dataclass(frozen=True, slots=True, eq=False)
class RefinementInputs:
    """All that doubtful pixels are scrutinised by."""

    planes: Mapping[str, Array]
    """(H, W) evidence by name, an ``impression`` among it."""
    surface: Surface
    likeness: PhotoConsistencyModel
    surroundings: Neighbourhood

    @classmethod
    def of(
        cls, planes: Mapping[str, Array], surface: Surface, likeness: PhotoConsistencyModel, scale: float
    ) -> RefinementInputs:
        """Of the evidence, the surface, and what it is compared by."""
        core, kernels = likeness.prepared.core, likeness.kernels
        around = Neighbourhood.of(surface.s, planes["impression"], core, AROUND_PX, scale, kernels)
        return cls(planes, surface, likeness, around)

    def look(self, at: Pixels, logit: Array) -> dict[str, Array]:
        """The evidence (1, N) of some pixels by name, of whom the logits (N,) are thought so far."""
        around = self.surroundings
        own = sample_planes(self.planes, at, around.kernels) | {"belief": np.asarray(logit, np.float32)}
        slopes = self.surface.slope_u[at], self.surface.slope_v[at]
        own |= dict(zip(("slope across", "slope down"), slopes, strict=True))
        found = (
            own | around.about(at) | around.relief(at, self.surface.s[at], *slopes) | self._tried(at, *slopes)
        )
        return {name: values[None] for name, values in found.items()}

    def state(self, at: Pixels, logit: Array) -> NDArray[np.float32]:
        """(S, N) what some pixels make of their own evidence, of whom the logits (N,) are thought so far."""
        shown = self.look(at, logit)
        return np.concatenate(load_network("scrutiny").answers(shown, self.likeness.kernels, 1))

    def _tried(self, at: Pixels, slope_u: Array, slope_v: Array) -> dict[str, Array]:
        """How like the images were if the pixels lay nearer or farther: (N,) by name."""
        scale = np.float32(self.surroundings.scale)
        moved = self.surface.s[at] + scale * np.array(TRIED_PX, np.float32)[:, None]
        slopes = (np.broadcast_to(slope, moved.shape) for slope in (slope_u, slope_v))
        like = self.likeness.of(at, moved, *slopes)
        return {
            f"{name} {px:+g}": row
            for name, rows in photo_consistency_features(like, len(self.likeness.prepared.images))
            if name != "seen by share"
            for px, row in zip(TRIED_PX, rows, strict=True)
        }


def mask_uncertain(logit: Array) -> NDArray[np.bool_]:
    """Who is scrutinised: neither lost nor sure."""
    return (logit >= _LOST) & (logit < _SURE)


def mask_accepted(logit: Array) -> NDArray[np.bool_]:
    """Who is believed without."""
    return logit >= _SURE


def refine_uncertain_pixels(thought: Prediction, scrutiny: RefinementInputs, threads: int) -> Prediction:
    """What is told of all pixels (H, W): of doubtful ones anew."""
    found = Prediction(*(plane.copy() for plane in thought))
    asked = mask_uncertain(thought.logit) & np.isfinite(thought.s)
    at = split_pixels(asked, _PIXELS)
    if not at:
        return found
    states = np.hstack(
        run_parallel([partial(scrutiny.state, part, thought.logit[part]) for part in at], threads)
    )
    scale, kernels = scrutiny.surroundings.scale, scrutiny.likeness.kernels
    around = neighbour_addresses(
        assign_addresses(asked, mask_accepted(thought.logit)), asked, scrutiny.surroundings.step
    )
    logit, log_sigma, shift = pass_messages(states, around, load_message_rounds(), kernels, threads)
    px = np.float32(scale)
    found.s[asked] += px * np.clip(shift, -MOST_PX, MOST_PX)
    found.logit[asked] = logit
    found.log_sigma[asked] = log_sigma + np.log(px)
    return found
