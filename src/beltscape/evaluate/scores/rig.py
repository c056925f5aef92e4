"""Scores of a rig against the true one: pose errors, and depth errors in the working volume."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from beltscape.core.geometry.rig import Rig
from beltscape.kernels import Kernels

WORKING_VOLUME_MM = ((-300.0, 300.0), (-240.0, 240.0), (600.0, 760.0))
"""Range of x, y, z in the core camera's frame: the belt, its load and its edges in the rendered captures."""


@dataclass(frozen=True, slots=True)
class RigScore:
    """Differences of a rig from the true one."""

    depth_rms_mm: float
    """Error of points projected with the true rig and triangulated with the tested one."""
    depth_max_mm: float
    rotation_deg: Mapping[str, float]
    """Angle between true and tested pose of each camera, about the core."""
    center_mm: Mapping[str, float]
    """Distance of each camera's centre from the true one, in the core's frame."""


def score_rig_against_truth(rig: Rig, truth: Rig, kernels: Kernels) -> RigScore:
    """Project a grid of points in the working volume with the true rig and triangulate them with the tested one."""
    axes = [np.linspace(low, high, 9) for low, high in WORKING_VOLUME_MM]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    names = [name for name in truth.cameras if name in rig.cameras]
    pixels = np.stack([truth.project_into(rig, name, points) for name in names])
    measured = kernels.triangulate(np.stack([rig.projection(name) for name in names]), pixels)
    error = measured[:, 2] - points[:, 2]
    error = error[np.isfinite(error)]
    differences = {name: rig.cam_from_core[name] @ truth.cam_from_core[name].inverse() for name in names}
    centers = {
        name: rig.cam_from_core[name].center_mm - truth.cam_from_core[name].center_mm for name in names
    }
    return RigScore(
        depth_rms_mm=float(np.sqrt((error**2).mean())) if error.size else float("nan"),
        depth_max_mm=float(np.abs(error).max()) if error.size else float("nan"),
        rotation_deg={name: pose.angle_deg for name, pose in differences.items()},
        center_mm={name: float(np.linalg.norm(offset)) for name, offset in centers.items()},
    )
