"""The error that inconsistent cameras give all pixels of a depth map in common."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.rig import Rig


def compute_depth_error_per_px(rig: Rig, depth: DepthMap) -> float:
    """Return the depth error (mm) of a pixel of disparity at the map's median depth, over the mean baseline."""
    baseline = float(np.mean([np.linalg.norm(rig.cam_from_core[n].center_mm) for n in rig.auxiliaries]))
    middle = float(np.nanmedian(depth.depth_mm))
    return middle**2 / (float(rig.core_camera.focal_px.mean()) * baseline)


def add_systematic_error(depth: DepthMap, systematic_mm: float) -> DepthMap:
    """Return the map with an error common to all pixels added to its σ."""
    sigma = np.hypot(depth.sigma_mm, np.float32(systematic_mm)).astype(np.float32)
    return replace(depth, sigma_mm=sigma, systematic_mm=systematic_mm)
