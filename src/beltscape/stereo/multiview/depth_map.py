"""The depth map of an estimate: from the matcher's grid to the pixels of the core's image, in mm."""

from __future__ import annotations

from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.stereo.multiview.confidence.estimate import DepthEstimate
from beltscape.stereo.multiview.frame.context import MatchContext
from beltscape.stereo.multiview.frame.surface import upsample_surface

Number = TypeVar("Number", bound=np.number)


def make_depth_map(estimate: DepthEstimate, context: MatchContext, least_confidence: float) -> DepthMap:
    """Return the depth of sufficiently confident pixels on the core's full grid."""
    unit, step = context.inverse_depth_scale, context.step
    s = upsample_surface(estimate.surface, step)
    sigma, confidence, views = (
        _repeat_blocks(x, step) for x in (estimate.sigma, estimate.confidence, estimate.views)
    )
    accepted = (confidence >= least_confidence) & (s > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(accepted, 1 / (s * np.float32(unit)), np.nan).astype(np.float32)
        sigma_mm = (depth * depth * np.float32(unit) * sigma).astype(np.float32)
    width, height = context.rig.core_camera.size_px
    missing = (
        (0, height - depth.shape[0]),
        (0, width - depth.shape[1]),
    )  # a last row or column without a block
    return DepthMap(
        np.pad(depth, missing, constant_values=np.nan),
        np.pad(sigma_mm, missing, constant_values=np.nan),
        np.pad(np.where(accepted, views, np.uint8(0)), missing),
        np.pad(np.where(accepted, confidence, np.float32(0)), missing),
    )


def _repeat_blocks(values: NDArray[Number], step: int) -> NDArray[Number]:
    """Return every value repeated over its block."""
    if step == 1:
        return values
    height, width = values.shape
    return cv2.resize(values, (width * step, height * step), interpolation=cv2.INTER_NEAREST)
