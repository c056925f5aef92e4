"""A frame's surface with all that the matcher knows of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.optimisation.least_squares import RefinementResult
from beltscape.stereo.multiview.optimisation.propagation import PropagationResult
from beltscape.stereo.multiview.selection.candidates import Selection


@dataclass(frozen=True, slots=True, eq=False)
class MatcherState:
    """On the matcher's own grid."""

    prepared: PreparedFrame
    chosen: PropagationResult
    """The last round of propagation."""
    refined: RefinementResult
    light: dict[str, NDArray[np.floating]]
    """(H, W) by name: the evidence of the core's image alone."""
    continued: NDArray[np.bool_]
    """(H, W) evenly lit discs whose surface is that of their rims."""
    contested: Selection | None
    """What a closer look at doubtful pixels found; None without that."""
