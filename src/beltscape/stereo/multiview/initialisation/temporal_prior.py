"""The temporal prior: the previous frame's surface, moved with the belt; where it fits, no sweep is needed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.inverse_depth import displace_projection
from beltscape.stereo.multiview.initialisation.unmeasured_regions import compute_local_share
from beltscape.stereo.multiview.optimisation.least_squares import form_normal_equations

_FIT_VARIANCE = 0.05
"""Model variance of normalised levels with which a surface that is off by half a pixel still fits."""
_LEAST_SHARE = 0.5
"""Share of the surrounding pixels at which the prediction must fit to be used for all of them."""


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """The depth map of the previous frame and the material's motion since then."""

    depth: DepthMap
    """Of the previous frame, from the same rig."""
    motion_mm: NDArray[np.float64]
    """(3,) displacement of the material since then, in the core camera's frame."""


def predict_inverse_depth(prior: Prior, prepared: PreparedFrame) -> NDArray[np.float32]:
    """Return (H, W) inverse depth s where the moved surface fits most of the images around; NaN elsewhere.

    A surface that moves by t relative to a fixed camera looks like a fixed surface from a camera moved by -t: the
    prediction is the inverse-depth buffer of that camera, with the core's pinhole.
    """
    context = prepared.context
    step, unit = context.step, context.inverse_depth_scale
    height, width = prepared.core.shape
    depth = prior.depth.depth_mm[step // 2 : height * step : step, step // 2 : width * step : step]
    with np.errstate(divide="ignore", invalid="ignore"):
        before = (1 / (depth * unit)).astype(np.float32)
    view = displace_projection(context.rig, prior.motion_mm * unit, step)
    (buffer,) = context.kernels.inverse_depth_buffers(
        before, view[None], [(width, height)], threads=context.threads
    )
    s = np.where(buffer > 0, buffer, np.nan).astype(np.float32)
    _, _, used = form_normal_equations(s, prepared, context.windows.levels_px, _FIT_VARIANCE)
    fits = used >= min(2, len(prepared.images))
    fitting_s = np.where(fits, s, np.nan).astype(np.float32)
    return np.where(compute_local_share(fits) > _LEAST_SHARE, s, fitting_s)
