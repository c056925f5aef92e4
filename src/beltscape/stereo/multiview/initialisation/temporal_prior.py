"""The surface of the frame before, moved with the belt: where it still fits, no sweep is needed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.rig import Rig
from beltscape.kernels import Kernels
from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.inverse_depth import displaced_projection
from beltscape.stereo.multiview.frame.windows import windows_for
from beltscape.stereo.multiview.initialisation.unmeasured_regions import local_share
from beltscape.stereo.multiview.optimisation.least_squares import form_normal_equations

_FIT_VARIANCE = 0.05
"""Of normalised levels: a surface that is off by half a pixel still fits."""
_MOST = 0.5
"""A surface that fits so much of the pixels about it is believed."""


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What was seen in the frame before, and how far it has moved since."""

    depth: DepthMap
    """Of the frame before, from the same rig."""
    motion_mm: NDArray[np.float64]
    """(3,) displacement of the material since then, in the core camera's frame."""


def predict_inverse_depth(
    prior: Prior, rig: Rig, prepared: PreparedFrame, unit: float, step: int, kernels: Kernels, threads: int
) -> NDArray[np.float32]:
    """(H, W) nearness s on the prepared grid where the moved surface, by and large, fits the images; NaN elsewhere.

    A surface that moves by t before a still camera is seen as a still one from a camera at -t: the moved
    nearness is the nearness buffer of that camera, with the core's own pinhole.
    """
    height, width = prepared.core.shape
    depth = prior.depth.depth_mm[step // 2 : height * step : step, step // 2 : width * step : step]
    with np.errstate(divide="ignore", invalid="ignore"):
        before = (1 / (depth * unit)).astype(np.float32)
    view = displaced_projection(rig, prior.motion_mm * unit, step)
    (buffer,) = kernels.inverse_depth_buffers(before, view[None], [(width, height)], threads=threads)
    s = np.where(buffer > 0, buffer, np.nan).astype(np.float32)
    _, _, used = form_normal_equations(
        s, prepared, windows_for(width).levels_px, _FIT_VARIANCE, kernels, threads
    )
    agreed = used >= min(2, len(prepared.images))
    fits = np.where(agreed, s, np.nan).astype(np.float32)
    return np.where(local_share(agreed) > _MOST, s, fits)
