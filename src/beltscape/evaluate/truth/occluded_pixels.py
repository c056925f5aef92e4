"""What no auxiliary sees, from the true depth of the core's view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.rig import Rig
from beltscape.kernels import Kernels
from beltscape.stereo.multiview.frame.frame import packed_projections
from beltscape.stereo.multiview.frame.inverse_depth import inverse_depth_scale
from beltscape.stereo.multiview.frame.visibility import count_visible_views


def never_seen(rig: Rig, true_depth_mm: NDArray[np.floating], kernels: Kernels) -> NDArray[np.bool_]:
    """(H, W) bool: pixels with a true depth that no auxiliary sees.

    The true depth (H, W; mm, NaN where there is none) is cast into each auxiliary. That is fair but not exact: what
    the core does not see hides nothing, so that a few pixels too many count as seen.
    """
    names = rig.auxiliaries
    unit = inverse_depth_scale(rig, names)
    s = (1 / (np.asarray(true_depth_mm, np.float64) * unit)).astype(np.float32)
    sizes = [rig.cameras[name].size_px for name in names]
    return np.isfinite(s) & (count_visible_views(s, packed_projections(rig, names, unit, 1), sizes, kernels) == 0)
