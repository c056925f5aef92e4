"""A frame's surface with all that the matcher knows of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.optimisation.least_squares import Refined
from beltscape.stereo.multiview.optimisation.propagation import Propagated
from beltscape.stereo.multiview.selection.candidates import Contested


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """On the matcher's own grid."""

    prepared: PreparedFrame
    chosen: Propagated
    """The last round of propagation."""
    refined: Refined
    light: dict[str, NDArray[np.floating]]
    """(H, W) by name: the evidence of the core's image alone."""
    continued: NDArray[np.bool_]
    """(H, W) evenly lit discs whose surface is that of their rims."""
    contested: Contested | None
    """What a closer look at doubtful pixels found; None without that."""
