"""A frame's surface with all that the matcher knows of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.contest import Contested
from beltscape.stereo.prepared import PreparedFrame
from beltscape.stereo.propagate import Propagated
from beltscape.stereo.refine import Refined


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
