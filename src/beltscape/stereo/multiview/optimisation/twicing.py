"""What windows have flattened, put back: tops and edges that planes fitted around every pixel cut.

A fit over windows W takes the surface t to W t: short of it on tops, beyond it in hollows. What is left shows in the
images still, as residuals that neighbours have in common. W of it is added where it is more than noise (twicing:
J. W. Tukey, Exploratory Data Analysis, 1977).
"""

from __future__ import annotations

import cv2
import numpy as np

from beltscape.kernels import Kernels
from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.nan import fill_nan
from beltscape.stereo.multiview.frame.surface import Surface
from beltscape.stereo.multiview.frame.windows import Windows, scaled_window
from beltscape.stereo.multiview.optimisation.least_squares import form_normal_equations

_AROUND_PX = 7
"""Window in which what is left is compared with its variance."""
_MOST_PX = 0.1
"""More than that is no flattening."""


def apply_twicing(
    surface: Surface, prepared: PreparedFrame, tolerance: float, size: Windows, kernels: Kernels, threads: int
) -> Surface:
    """The refined surface with what windows have taken off it; NaN stays.

    ``tolerance`` is in px, as that of `beltscape.stereo.multiview.optimisation.least_squares.refine`.
    """
    information, pull, _ = form_normal_equations(
        surface.s, prepared, size.levels_px, prepared.noise.model, kernels, threads
    )
    fit = kernels.local_fit(
        information, pull, surface.s, surface.slope_u, surface.slope_v, radii=size.firm, tolerance=tolerance,
        flatten=0.0, threads=threads,
    )  # fmt: skip
    left = fit.s - surface.s
    side = scaled_window(_AROUND_PX, size.scale)
    energy = cv2.blur(np.minimum(fill_nan(left) ** 2, _MOST_PX**2), side)
    noise = cv2.blur(np.minimum(fill_nan(fit.variance), _MOST_PX**2), side)
    share = np.maximum(1 - noise / np.maximum(energy, np.float32(1e-12)), 0)
    return Surface(
        surface.s + share * left,
        surface.slope_u + share * (fit.slope_u - surface.slope_u),
        surface.slope_v + share * (fit.slope_v - surface.slope_v),
    )
