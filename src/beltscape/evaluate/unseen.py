"""What no auxiliary sees, from the true depth of the core's view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.rig import Rig
from beltscape.kernels import Kernels
from beltscape.stereo.nearness import nearness_unit, view_row

_OCCLUDER_PX = 2.0
"""How much nearer, px of disparity, something must lie to hide a pixel: more than the surface's own slope does."""


def never_seen(rig: Rig, true_depth_mm: NDArray[np.floating], kernels: Kernels) -> NDArray[np.bool_]:
    """(H, W) bool: pixels with a true depth that no auxiliary sees.

    The true depth (H, W; mm, NaN where there is none) is cast into each auxiliary. That is fair but not exact: what
    the core does not see hides nothing, so that a few pixels too many count as seen.
    """
    names = rig.auxiliaries
    unit = nearness_unit(rig, names)
    s = (1 / (np.asarray(true_depth_mm, np.float64) * unit)).astype(np.float32)
    views = np.stack([view_row(rig, name, unit) for name in names])
    buffers = kernels.nearness_buffers(s, views, [rig.cameras[name].size_px for name in names])
    seen = [
        kernels.visible(s, view, buffer, _OCCLUDER_PX) for view, buffer in zip(views, buffers, strict=True)
    ]
    return np.isfinite(s) & ~np.any(seen, axis=0)
