"""The state of the matcher for one frame: the results of its stages so far."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.optimisation.least_squares import LeastSquaresResult
from beltscape.stereo.multiview.optimisation.propagation import PropagationResult
from beltscape.stereo.multiview.selection.candidates import Selection


@dataclass(frozen=True, slots=True, eq=False)
class MatcherState:
    """The results of the stages on the matcher's grid."""

    prepared: PreparedFrame
    propagated: PropagationResult
    """Result of the last round of propagation."""
    solution: LeastSquaresResult
    image_features: dict[str, NDArray[np.floating]]
    """(H, W) by name: the features of the core's image."""
    textured: NDArray[np.bool_]
    """(H, W) pixels near which the core's image has texture."""
    filled: NDArray[np.bool_]
    """(H, W) textureless discs whose surface is continued from their rims."""
    selection: Selection | None
    """Result of the candidate selection; None without one."""
