"""Pixels of the core camera whose surface is occluded in every auxiliary, from the true depth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.rig import Rig
from beltscape.kernels import Kernels
from beltscape.stereo.multiview.frame.inverse_depth import compute_inverse_depth_scale, pack_projections
from beltscape.stereo.multiview.frame.surface import compute_visibility


def occluded_mask(rig: Rig, true_depth_mm: NDArray[np.floating], kernels: Kernels) -> NDArray[np.bool_]:
    """Return the mask (H, W) of pixels with a true depth that are occluded in every auxiliary.

    The true depth (H, W; mm, NaN: none) is projected into each auxiliary. Surfaces outside the core's view do not
    occlude here, so a few occluded pixels count as visible.
    """
    names = rig.auxiliaries
    unit = compute_inverse_depth_scale(rig, names)
    s = (1 / (np.asarray(true_depth_mm, np.float64) * unit)).astype(np.float32)
    sizes = [rig.cameras[name].size_px for name in names]
    visible, _ = compute_visibility(s, pack_projections(rig, names, unit, 1), sizes, kernels)
    return np.isfinite(s) & (visible == 0)
