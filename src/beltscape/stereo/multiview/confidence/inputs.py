"""The inputs of the confidence: a matched surface and its fits as planes without NaN, prepared once per surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.planes import fill_nan
from beltscape.stereo.multiview.frame.surface import Surface, compute_visibility, detect_depth_steps
from beltscape.stereo.multiview.frame.windows import Windows
from beltscape.stereo.multiview.state import MatcherState

Array = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class ConfidenceInputs:
    """Planes (H, W) from which the features of a surface are computed; without NaN unless stated."""

    prepared: PreparedFrame
    image_features: dict[str, NDArray[np.floating]]
    """By name: the features of the core's image."""
    surface: Surface
    """As matched, with NaN where there is none."""
    filled: Surface
    """The surface with 0 in place of NaN, as in all planes below unless stated."""
    propagated_s: Array
    """Inverse depth before the last iterations of least squares."""
    depth_steps: NDArray[np.bool_]
    """Pixels beside depth steps."""
    visible: NDArray[np.uint8]
    """Number of auxiliaries that see the surface."""
    buffers: list[NDArray[np.floating]]
    """n of (h, w): the auxiliaries' inverse-depth buffers of the surface."""
    agreeing: NDArray[np.uint8]
    """Number of auxiliaries that agree with the core."""
    cost: Array
    """Dissimilarity of the images, 0..1, with 1 in place of NaN."""
    margin: Array
    """Difference to the cost of the next candidate."""
    information: Array
    """Of the pixel alone, 1/px²."""
    variance: Array
    """Of s, px²; NaN where the fit has none."""
    filled_variance: Array
    """The variance with 1 in place of NaN."""
    disagreement: Array
    """Between the windows of the fit, in units of the smaller one's variance."""

    @classmethod
    def from_state(cls, state: MatcherState) -> ConfidenceInputs:
        """Return the inputs for the matcher's surface."""
        surface, solution, propagated = state.solution.surface, state.solution, state.propagated
        filled = Surface(fill_nan(surface.s), fill_nan(surface.slope_u), fill_nan(surface.slope_v))
        propagated_s, cost, margin = (
            fill_nan(propagated.surface.s), fill_nan(propagated.cost, 1.0), fill_nan(propagated.margin),
        )  # fmt: skip
        information, disagreement = fill_nan(solution.information), fill_nan(solution.disagreement)
        filled_variance = fill_nan(solution.variance, 1.0)
        depth_steps = detect_depth_steps(filled.s)
        visible, buffers = compute_visibility(surface.s, state.prepared)
        return cls(
            state.prepared, state.image_features, surface, filled, propagated_s, depth_steps, visible, buffers,
            solution.used, cost, margin, information, solution.variance, filled_variance, disagreement,
        )  # fmt: skip

    @property
    def windows(self) -> Windows:
        """Window sizes of the grid."""
        return self.prepared.context.windows

    @property
    def auxiliaries(self) -> int:
        """Number of auxiliaries."""
        return len(self.prepared.images)
