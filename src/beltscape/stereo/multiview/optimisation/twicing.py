"""Twicing: correction of the bias by which the fit's windows flatten tops and edges.

A fit over windows W maps the surface t to W t, which is too low on tops and too high in hollows. The difference
remains in the images as residuals that neighbours have in common. W of it is added where it exceeds the noise
(J. W. Tukey, Exploratory Data Analysis, 1977).
"""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.surface import Surface, fill_nan
from beltscape.stereo.multiview.optimisation.least_squares import form_normal_equations

_WINDOW_PX = 7
"""Window in which the remaining shift is compared with its variance."""
_MOST_PX = 0.1
"""Limit of the remaining shift; a larger one is no flattening."""


def apply_twicing(surface: Surface, prepared: PreparedFrame, tolerance: float) -> Surface:
    """Return the surface with the flattening of its windows corrected; NaN stays.

    ``tolerance`` (px) is that of `least_squares.solve_least_squares`.
    """
    context = prepared.context
    information, pull, _ = form_normal_equations(
        surface.s, prepared, context.windows.levels_px, prepared.noise.model
    )
    fit = context.kernels.local_fit(
        information, pull, surface.s, surface.slope_u, surface.slope_v, radii=context.windows.firm,
        tolerance=tolerance, flatten=0.0, threads=context.threads,
    )  # fmt: skip
    shift = fit.s - surface.s
    window = context.windows.boxes[_WINDOW_PX]
    energy, noise = (
        cv2.blur(np.minimum(plane, _MOST_PX**2, out=plane), window)
        for plane in (np.square(fill_nan(shift)), fill_nan(fit.variance))
    )
    share = 1 - noise / np.maximum(energy, np.float32(1e-12), out=energy)
    np.maximum(share, 0, out=share)
    return Surface(
        cast("NDArray[np.float32]", surface.s + share * shift),
        cast("NDArray[np.float32]", surface.slope_u + share * (fit.slope_u - surface.slope_u)),
        cast("NDArray[np.float32]", surface.slope_v + share * (fit.slope_v - surface.slope_v)),
    )
